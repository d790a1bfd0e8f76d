"""Commands that are not set-points of their joints are told by name."""

from __future__ import annotations

import re

import numpy as np
import pytest
from servo_arms import commands, recorded

from estimators.diagnosis.from_motion.checks.commands import check_commands
from limo_driver.errors import RecordingError

TIME, COMMAND = commands(20.0, 50.0)
LATE = 4  # rows


def followed(command):
    """Return positions that follow commands a few rows later."""
    return np.concatenate([np.tile(command[:1], (LATE, 1)), command[:-LATE]])


def exchanged(command):
    return command[:, ::-1]


def deltas(command):
    return np.gradient(followed(command), axis=0)


@pytest.mark.parametrize(
    ("mistake", "message"),
    [
        (lambda c: np.rad2deg(2.0 * c), "are the commands normalised, as -100 to 100?"),
        (np.rad2deg, "are the commands in degrees, or normalised, as -100 to 100?"),
        (lambda c: 100.0 * c / np.abs(c).max(), "are the commands normalised, as -100 to 100?"),
        (lambda c: 0.5 * c, "are the commands normalised, as -1 to 1?"),
        (deltas, "are the commands deltas?"),
        (exchanged, "are joints exchanged?"),
        (np.negative, "has one of them the other sign?"),
        (np.zeros_like, "no command changes while the joints move"),
        (followed, "command_1 is position_1 itself"),
        (lambda c: np.roll(followed(c), -1, axis=0), "command_1 is position_1 of 1 row later"),
    ],
)
def test_a_mistake_is_refused_by_name(mistake, message):
    recording = recorded(TIME, mistake(COMMAND), followed(COMMAND))

    with pytest.raises(RecordingError, match=re.escape(message)):
        check_commands([recording])


def test_set_points_are_taken():
    assert check_commands([recorded(TIME, COMMAND, followed(COMMAND))]) == ()


def test_a_servo_that_rests_near_where_its_command_swings_is_told():
    position, command = followed(COMMAND), COMMAND.copy()
    position[500:, 1] = 0.0
    command[500:, 1] = 0.2 * np.sin(8.0 * TIME[500:])

    (said,) = check_commands([recorded(TIME, command, position)])

    assert said.startswith("joint 2 is stalled: it rests while its command moves 0.")


@pytest.mark.parametrize("since", [0, 500])
def test_a_servo_that_is_stuck_while_its_command_swings_little_is_told(since):
    command = np.stack([COMMAND[:, 0], 0.08 * np.sin(2.0 * TIME)], axis=1)
    position = followed(command)
    position[since:, 1] = position[since, 1]

    (said,) = check_commands([recorded(TIME, command, position)])

    assert said.startswith("joint 2 is stalled: it rests while its command moves 0.16 rad")


def test_friction_that_holds_a_joint_at_each_reversal_is_no_stall():
    command = np.stack([COMMAND[:, 0], 0.2 * np.sin(0.8 * TIME)], axis=1)
    position, at = followed(command), 0.0
    for k, wanted in enumerate(position[:, 1]):  # within 0.06 rad of its command, it rests
        at = float(np.clip(at, wanted - 0.06, wanted + 0.06))
        position[k, 1] = at

    assert check_commands([recorded(TIME, command, position)]) == ()


def test_a_stalled_servo_is_told():
    position = followed(COMMAND)
    position[500:, 1] = position[500, 1]

    (said,) = check_commands([recorded(TIME, COMMAND, position)])

    assert said.startswith("joint 2 is stalled")


@pytest.mark.parametrize("lasting", [1.0, 3.0])
@pytest.mark.parametrize("size", [0.3, 1.0])
def test_a_servo_that_stalls_and_is_let_go_is_told_with_its_times(lasting, size):
    command = size * COMMAND
    position = followed(command)
    rows = slice(365, 365 + round(50.0 * lasting))
    position[rows, 1] = position[rows.start, 1]
    back = slice(rows.stop, rows.stop + 8)  # how fast it returns
    share = np.linspace(0.0, 1.0, 8)
    position[back, 1] = (1.0 - share) * position[rows.start, 1] + share * position[back, 1]

    (said,) = check_commands([recorded(TIME, command, position)])

    assert said.startswith("joint 2 is stalled: it rests while its command moves")
    assert f"7.3 s to {7.3 + lasting:.1f} s" in said


def test_a_joint_that_rests_against_its_command_until_it_jumps_is_told_with_its_times():
    position = followed(COMMAND)
    position[365:440, 1] = position[365, 1]

    recording = recorded(TIME, COMMAND, position)
    said = check_commands([recording])

    assert [len(item.rows) for item in recording.left_out] == [74]
    (told,) = [text for text in said if text.startswith("joint 2")]
    assert told.startswith("joint 2 is stalled, or its encoder hangs")
    assert "7.3 s to 8.8 s" in told


def test_a_servo_without_torque_is_told():
    command, position = COMMAND.copy(), followed(COMMAND)
    command[600:] = command[600]
    position[600:] = command[600]
    position[700:800, 0] += 0.8 * np.sin(np.pi * np.arange(100) / 100.0)

    (said,) = check_commands([recorded(TIME, command, position)])

    assert "joint 1 moves away from a command that rests; was its torque disabled?" in said


@pytest.mark.parametrize(("rests", "said"), [(0.0, "moved away from its"), (0.6, "is stalled")])
def test_a_soft_servo_that_falls_is_told_from_one_that_is_held(rests, said):
    """It sags by half of its command, so that it was never near it."""
    command = COMMAND.copy()
    command[500:, 1] = 1.2
    position = np.stack([followed(COMMAND)[:, 0], 0.5 * followed(command)[:, 1]], axis=1)
    position[500:, 1] = 0.6
    position[520:, 1] = rests

    (told,) = check_commands([recorded(TIME, command, position)])

    assert told.startswith(f"joint 2 {said}")


def test_a_servo_that_falls_while_its_command_moves_is_told():
    position = followed(COMMAND)
    fallen = position[400, 1] + 2.0 * (1.0 - np.exp(-np.arange(200) / 5.0))
    position[400:600, 1] = np.round(fallen, 3)
    position[600:, 1] = np.linspace(position[599, 1], COMMAND[-1, 1], 400)

    (said,) = check_commands([recorded(TIME, COMMAND, position)])

    assert said.startswith("joint 2 moved away from its command")
    assert "was its torque disabled? (recording 1, 9.0 s)" in said


def test_dropped_frames_are_told():
    kept = np.ones(TIME.size, dtype=bool)
    kept[300:320] = kept[700:730] = False

    (said,) = check_commands([recorded(TIME[kept], COMMAND[kept], followed(COMMAND)[kept])])

    assert said.startswith("rows are missing: 2 gaps; the longest, 0.62 s, after 13.98 s")


def test_single_rows_that_are_missing_are_told():
    kept = np.ones(TIME.size, dtype=bool)
    kept[[100, 300, 500, 700]] = False
    uneven = TIME + 0.3 / 50.0 * np.random.default_rng(0).uniform(-1.0, 1.0, TIME.size)

    (said,) = check_commands([recorded(TIME[kept], COMMAND[kept], followed(COMMAND)[kept])])
    unsaid = check_commands([recorded(uneven[kept], COMMAND[kept], followed(COMMAND)[kept])])

    assert said.startswith("rows are missing: 4 times the next one came two periods later or more")
    assert said.endswith("first at 2.0 s)")
    assert not any("rows are missing" in text for text in unsaid)


def test_rows_that_were_left_out_are_not_missing():
    position = followed(COMMAND)
    position[[200, 400, 600, 800], 0] += 0.9

    recording = recorded(TIME, COMMAND, position)

    assert sum(len(item.rows) for item in recording.left_out) == 4
    assert check_commands([recording]) == ()


def test_steps_of_numbers_are_no_encoders():
    """As numbers of 32 bits have them, of a joint without encoder that comes to rest."""
    steps, resting = np.array([3.33e-8, 8.4e-9]), TIME > 10.0
    command = COMMAND[np.minimum(np.arange(TIME.size), 500)]
    position = steps * np.round(followed(command) / steps)
    position += resting[:, None] * steps * np.random.default_rng(0).integers(0, 3, position.shape)

    assert check_commands([recorded(TIME, command, position)]) == ()


def test_many_frames_that_were_dropped_at_once_are_told():
    kept = np.ones(TIME.size, dtype=bool)
    kept[540:600] = False
    rows = int(kept.sum())

    (said,) = check_commands([recorded(TIME[:rows], COMMAND[kept], followed(COMMAND)[kept])])

    assert said.startswith("joints and their commands jump within one row")
    assert said.endswith("(recording 1, 10.8 s)")


def test_a_command_that_steps_is_no_dropped_frame():
    command = COMMAND + np.where(TIME > 10.0, 0.8, 0.0)[:, None]

    assert check_commands([recorded(TIME, command, followed(command))]) == ()


def test_an_arm_led_by_hand_is_told():
    command = np.array([1.0, 0.1]) * COMMAND
    position = followed(command)
    position[:, 1] += 0.8 * np.sin(np.pi * np.clip((TIME - 8.0) / 4.0, 0.0, 1.0))

    (said,) = check_commands([recorded(TIME, command, position)])

    assert said.startswith("joint 2 moves 0.")
    assert "was its torque disabled, or the arm led by hand? (recording 1, " in said


def test_a_servo_that_sags_far_from_its_command_is_not_led():
    command = COMMAND + np.array([0.0, 0.6]) * (TIME > 6.0)[:, None]
    position = followed(COMMAND)
    position[:, 1] *= 0.6

    assert not any(
        "led by hand" in said for said in check_commands([recorded(TIME, command, position)])
    )


@pytest.mark.parametrize("scale", [100.0, 57.3])
def test_values_in_another_unit_throughout_are_refused(scale):
    """Commands and positions alike, as LeRobot records them."""
    told = scale * COMMAND / np.abs(COMMAND).max()

    with pytest.raises(RecordingError, match="are both in degrees, or normalised"):
        check_commands([recorded(TIME, told, followed(told))])


@pytest.mark.parametrize(
    ("scales", "unit"),
    [
        ((200.0 / 3.5, 200.0 / 3.4), "in degrees, or normalised, as -100 to 100"),
        ((200.0 / 3.5, 200.0 / 5.6), "normalised, as -100 to 100"),
    ],
)
def test_normalised_commands_are_not_taken_for_degrees(scales, unit):
    """Joints of 200 degrees have nearly as many hundredths of their half range."""
    with pytest.raises(RecordingError, match=f"are the commands {unit}\\?"):
        check_commands([recorded(TIME, np.array(scales) * COMMAND, followed(COMMAND))])


def test_positions_alone_in_another_unit_are_refused():
    with pytest.raises(RecordingError, match="are the positions in degrees, or normalised"):
        check_commands([recorded(TIME, COMMAND, np.rad2deg(followed(COMMAND)))])


def test_a_rest_far_from_zero_is_in_another_unit():
    told = 20.0 + 5.0 * COMMAND

    with pytest.raises(RecordingError, match="are both in degrees, or normalised"):
        check_commands([recorded(TIME, told, followed(told))])


TICK = 2.0 * np.pi / 4096


def test_steps_of_no_encoder_are_told():
    """Normalised by each joint's own range, and far from its ends."""
    position = TICK * np.round(followed(COMMAND) / TICK) / np.array([1.9, 1.7])

    (said,) = check_commands([recorded(TIME, COMMAND / np.array([1.9, 1.7]), position)])

    assert said.startswith("position_1 comes in steps of 0.000807, position_2 of 0.000902")
    assert "are positions and commands normalised, as -1 to 1?" in said


@pytest.mark.parametrize("tick", [TICK, 2.0 * np.pi / 65536, 1e-4])
def test_steps_of_an_encoder_or_of_digits_are_not(tick):
    position = tick * np.round(followed(COMMAND) / tick)

    assert check_commands([recorded(TIME, COMMAND, position)]) == ()


def test_values_from_minus_one_to_one_throughout_are_refused():
    told = np.clip(COMMAND * 1.2 / np.abs(COMMAND).max(axis=0), -1.0, 1.0)

    with pytest.raises(RecordingError, match="are both normalised, as -1 to 1"):
        check_commands([recorded(TIME, told, followed(told))])


def test_frames_that_were_dropped_and_stamped_evenly_are_told():
    kept = np.ones(TIME.size, dtype=bool)
    kept[210:213] = kept[500:503] = kept[601] = False
    rows = int(kept.sum())

    (said,) = check_commands([recorded(TIME[:rows], COMMAND[kept], followed(COMMAND)[kept])])

    assert said.startswith("in 3 rows joints move much further than in the rows around")
    assert said.endswith("first at 4.2 s)")


SLOW = np.arange(0.0, 40.0, 0.1)  # [s], of a logger at 10 Hz


def wave(pace, phase=0.0, time=SLOW):
    return np.sin(2.0 * np.pi * pace * time + phase)


def test_joints_that_start_and_stop_within_rows_lost_no_frames():
    """Two of them swing twice a second: the row in the middle of a swing is by far the longest."""
    command = np.stack([0.4 * wave(1.93), 0.3 * wave(1.93)], axis=1)

    assert check_commands([recorded(SLOW, command, 0.9 * command)]) == ()


def test_frames_dropped_at_a_slow_rate_are_told():
    kept = np.ones(SLOW.size, dtype=bool)
    kept[[93, 197, 301]] = False
    command = np.stack([2.0 * wave(0.05), 1.5 * wave(0.05, 0.2)], axis=1)
    position = TICK * np.round(0.95 * command / TICK)
    rows = int(kept.sum())

    (said,) = check_commands([recorded(SLOW[:rows], command[kept], position[kept])])

    assert "were frames dropped and the others stamped evenly?" in said


@pytest.mark.parametrize("time", [SLOW, TIME])
def test_exchanged_joints_a_quarter_apart_are_not_called_deltas(time):
    """Each is as the other's change."""
    command = np.stack([0.5 * wave(0.3, 0.0, time), 0.5 * wave(0.3, np.pi / 2, time)], axis=1)

    with pytest.raises(RecordingError, match="are joints exchanged"):
        check_commands([recorded(time, exchanged(command), 0.95 * command)])


@pytest.mark.parametrize("delta", [lambda c: np.diff(c, axis=0, prepend=c[:1]), deltas])
def test_deltas_of_joints_a_quarter_apart_are_not_called_exchanged(delta):
    command = np.stack([0.5 * wave(0.3), 0.5 * wave(0.3, np.pi / 2)], axis=1)

    with pytest.raises(RecordingError, match="are the commands deltas"):
        check_commands([recorded(SLOW, delta(command), followed(command))])


def test_exchanged_joints_that_move_alike_are_told_by_how_far_they_go():
    command = np.array([0.8, 0.4]) * COMMAND[:, :1]

    with pytest.raises(RecordingError, match=r"position_. follows command_.*are joints exchanged"):
        check_commands([recorded(TIME, exchanged(command), followed(command))])


def test_one_joint_that_moves_alone_beside_the_command_of_another_is_told():
    command = np.stack([COMMAND[:, 0], np.full(TIME.size, 0.2)], axis=1)

    with pytest.raises(RecordingError, match="position_1 follows command_2, not command_1"):
        check_commands([recorded(TIME, exchanged(command), followed(command))])


def test_joints_that_move_one_after_the_other_are_not_exchanged():
    """Each lags so that it is where the next one is told to be."""
    command = np.stack([0.4 * wave(0.5, -k, TIME) for k in range(4)], axis=1)
    position = np.stack([0.4 * wave(0.5, -k - 1.0, TIME) for k in range(4)], axis=1)

    assert check_commands([recorded(TIME, command, position)]) == ()


def test_a_joint_of_the_other_sign_beside_one_that_moves_alike_is_not_exchanged():
    command = COMMAND[:, :1] * np.array([1.0, 0.7])

    with pytest.raises(RecordingError, match="position_1 moves against command_1"):
        check_commands([recorded(TIME, command * np.array([-1.0, 1.0]), followed(command))])


def test_a_joint_that_is_stuck_but_for_a_start_is_in_no_other_unit():
    """It moves by a ninth of what it is told, once."""
    position = followed(COMMAND)
    position[:, 1] = np.where(TIME < 1.0, 0.0, 0.12) + 0.4

    (said,) = check_commands([recorded(TIME, COMMAND, position)])

    assert said.startswith("joint 2 is stalled")


@pytest.mark.parametrize("time", [SLOW, TIME])
def test_a_joint_that_rests_as_told_and_then_steps_lost_no_rows(time):
    command = np.where(time < 6.0, 0.0, 0.7)[:, None] + np.zeros(2)
    command[time > 8.0] += 0.1 * wave(0.2, 0.0, time[time > 8.0])[:, None]
    position = 0.98 * np.concatenate([command[:1], command[:-1]])

    recording = recorded(time, command, position)

    assert not recording.left_out
    assert check_commands([recording]) == ()


def stuck_until(command, most):
    """Return where a joint is that friction holds until its command is so far away, (T,) [rad]."""
    position = np.empty_like(command)
    at = command[0]
    for row, wanted in enumerate(command):
        at = wanted if abs(wanted - at) > most else at
        position[row] = at
    return position


def test_a_joint_that_sticks_and_breaks_away_lost_no_rows():
    command = 0.1 * np.stack([wave(0.05, 0.0, SLOW), wave(0.05, 1.0, SLOW)], axis=1)
    position = np.stack([stuck_until(command[:, 0], 0.04), 0.98 * command[:, 1]], axis=1)

    recording = recorded(SLOW, command, position)

    assert not recording.left_out
    assert check_commands([recording]) == ()


def test_a_sensor_that_hangs_beside_a_joint_that_sticks_is_told():
    command = 0.1 * np.stack([wave(0.05, 0.0, SLOW), wave(0.05, 1.0, SLOW)], axis=1)
    position = np.stack([stuck_until(command[:, 0], 0.04), 0.98 * command[:, 1]], axis=1)
    position[60:80, 1] = position[60, 1]

    recording = recorded(SLOW, command, position)

    assert [item.reason for item in recording.left_out] == [
        "position_2 repeats a value while the joint moves"
    ]


def test_a_command_that_comes_with_the_last_rows_stalls_no_joint():
    command = np.stack([COMMAND[:, 0], np.where(TIME < 19.8, 0.0, 0.2)], axis=1)
    position = followed(COMMAND)
    position[:, 1] = 0.0

    assert check_commands([recorded(TIME, command, position)]) == ()


def test_columns_that_are_one_place_off_are_told():
    command = np.stack([0.4 * wave(pace, 0.0, TIME) for pace in (0.23, 0.31, 0.47)], axis=1)
    position = 0.95 * followed(command)

    with pytest.raises(RecordingError, match="are joints exchanged"):
        check_commands([recorded(TIME, np.roll(command, 1, axis=1), position)])
