"""Commanded velocities that are no velocities of their joints are told by name."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from servo_arms import VELOCITY, commands, recorded

from estimators.diagnosis.from_motion.checks.commands import check_commands
from limo_driver.errors import RecordingError

RATE = 50.0
TIME, WANTED = commands(20.0, RATE)
COMMAND = np.gradient(WANTED, TIME, axis=0)
LATE = 4  # rows
POSITION = 0.8 * np.concatenate([np.tile(WANTED[:1], (LATE, 1)), WANTED[:-LATE]])


def told(command, position=POSITION):
    return recorded(TIME, command, position, VELOCITY)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (np.rad2deg, "are the commands in deg/s?"),
        (lambda c: c * 30 / np.pi, "are the commands in revolutions per minute?"),
        (lambda c: c / RATE, "are the commands changes of the position by row?"),
        (lambda c: 200.0 * c, "are the commands in another unit, or normalised?"),
        (lambda c: 0.4 * c, "are the commands in another unit, or normalised?"),
        (np.negative, "has one of them the other sign?"),
        (lambda c: c[:, ::-1], "joint 1 follows command_velocity_2, not command_velocity_1"),
        (np.zeros_like, "command_velocity_1 is always 0 while joint 1 moves"),
        (
            lambda _: WANTED,
            "are these set-points of positions, command_1?",
        ),
        (lambda _: np.gradient(POSITION, TIME, axis=0), "is the velocity of joint 1 itself"),
    ],
)
def test_a_mistake_is_refused_by_name(mistake, message):
    with pytest.raises(RecordingError, match=re.escape(message)):
        check_commands([told(mistake(COMMAND))])


def test_velocities_are_taken():
    assert check_commands([told(COMMAND)]) == ()


def test_velocities_in_columns_of_positions_are_refused():
    with pytest.raises(RecordingError, match="are the commands deltas"):
        check_commands([recorded(TIME, COMMAND, POSITION)])


def test_a_stalled_joint_is_told():
    command, position = COMMAND.copy(), POSITION.copy()
    position[600:, 1] += position[500, 1] - position[600, 1]
    command[500:600, 1], position[500:600, 1] = 0.5, position[500, 1]

    (said,) = check_commands([told(command, position)])

    assert said.startswith("joint 2 is stalled: it rests while it is told 0.50 rad/s (recording 1")


def test_a_joint_that_moves_though_told_to_rest_is_told():
    command, position = COMMAND.copy(), POSITION.copy()
    command[500:700, 1] = 0.0

    (said,) = check_commands([told(command, position)])

    assert re.match(r"joint 2 moves by 0\.\d+ rad while it is told to rest", said)


def test_what_is_wrong_with_either_kind_of_command_is_told_in_one_arm():
    mixed = (*VELOCITY[:1], "command")
    good = np.stack([COMMAND[:, 0], WANTED[:, 1]], axis=1)
    position = np.stack([POSITION[:, 0], POSITION[:, 1] / 0.8], axis=1)
    recording = recorded(TIME, good, position, mixed)
    assert check_commands([recording]) == ()

    for factor, message in (((57.3, 1.0), "in deg/s"), ((1.0, 57.3), "command_2 spans 9")):
        with pytest.raises(RecordingError, match=message):
            check_commands([replace(recording, command=good * np.array(factor))])
