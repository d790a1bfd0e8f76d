"""Commands that stand at later rows than they came into force are told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from servo_arms import commands, recorded, write_arm

from estimators.diagnosis.from_motion import free_run
from estimators.diagnosis.from_motion.checks.timing import check_timing
from limo_driver.errors import RecordingError
from limo_driver.physics import Simulation

RATE, DELAY = 50.0, 0.02


@pytest.fixture(scope="module")
def stated(tmp_path_factory):
    simulation = Simulation.load(write_arm(tmp_path_factory.mktemp("arm") / "arm.xml"))
    return replace(simulation, drives=tuple(replace(d, delay=DELAY) for d in simulation.drives))


@pytest.fixture(scope="module")
def recording(stated):
    time, command = commands(10.0, RATE, 2.0)
    return recorded(time, command, free_run(stated, recorded(time, command, command)))


def later(recording, rows):
    """Return the recording with each command some rows later."""
    first = recording.command[:1].repeat(rows, axis=0)
    command = np.concatenate([first, recording.command[:-rows]])
    return recorded(recording.time, command, recording.position)


def test_commands_in_force_at_their_rows_are_taken(stated, recording):
    assert check_timing(stated, [recording]) == ()


def test_a_delay_that_is_missing_is_told(stated, recording):
    (said,) = check_timing(stated, [later(recording, 2)])

    assert said.startswith("No joint has a delay, although 0.02 s are stated")


@pytest.fixture(scope="module")
def damped(tmp_path_factory):
    """Return an arm whose servos have no delay, and lag by a tenth of a second."""
    path = write_arm(tmp_path_factory.mktemp("damped") / "arm.xml", kd=(4.5, 2.4))
    return Simulation.load(path)


@pytest.mark.parametrize("pace", [1.0, 2.0])
@pytest.mark.parametrize(("late", "said"), [(0, ""), (2, "0.04"), (5, "0.1")])
def test_lateness_that_damping_hides_is_told_where_no_delay_is_stated(damped, pace, late, said):
    time, command = commands(10.0, RATE, pace)
    swung = recorded(time, command, free_run(damped, recorded(time, command, command)))

    told = check_timing(damped, [later(swung, late) if late else swung])

    assert len(told) == bool(said)
    assert all(f"follow their commands {said}" in text for text in told)


@pytest.mark.parametrize("least", [0.3, 0.7])
def test_damping_that_is_wrong_behind_servos_with_a_delay_is_no_lateness(damped, least):
    drives = tuple(replace(d, kd=least * d.kd, delay=0.02) for d in damped.drives)
    time, command = commands(10.0, RATE, 2.0)
    arm = replace(damped, drives=drives)
    swung = recorded(time, command, free_run(arm, recorded(time, command, command)))

    assert check_timing(damped, [swung]) == ()


def test_commands_later_than_what_they_cause_are_refused(stated, recording):
    with pytest.raises(RecordingError, match="or more later than the positions that follow them"):
        check_timing(stated, [later(recording, 10)])


def test_another_recording_whose_commands_come_later_is_refused(stated, recording):
    with pytest.raises(RecordingError, match="or more later than the positions that follow them"):
        check_timing(stated, [recording, later(recording, 10)])


def test_weak_servos_that_are_driven_beyond_their_torque_are_taken(stated):
    weak = replace(
        stated,
        drives=tuple(
            replace(drive, kp=0.02 * drive.kp, kd=0.005 * drive.kd, torque_limit=0.15)
            for drive in stated.drives
        ),
    )
    time, command = commands(10.0, RATE, 2.0)
    swung = recorded(time, command, free_run(weak, recorded(time, command, command)))

    assert np.abs(swung.command - swung.position).mean() > 0.2  # they do not follow
    assert check_timing(stated, [swung]) == ()
