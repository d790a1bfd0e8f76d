"""Recordings of drives that tell commands and positions, and no torque."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.recordings.recording import Recording

TIME = np.arange(200) / 50.0
POSITION = 0.3 * np.sin(TIME)[:, None] * np.ones(2)
COMMAND = 0.3 * np.sin(TIME + 0.1)[:, None] * np.ones(2)


def test_commands_stand_in_for_torques():
    recording = Recording.from_arrays(TIME, POSITION, command=COMMAND)

    assert not recording.has_torque
    assert recording.command == pytest.approx(COMMAND)
    assert not recording.warnings
    with pytest.raises(RecordingError, match="lacks torque_1"):
        recording.filtered_torque(10.0)


def test_commands_stand_beside_torques():
    recording = Recording.from_arrays(TIME, POSITION, 0.1 + COMMAND, command=COMMAND)

    assert recording.has_torque
    assert recording[50:].command == pytest.approx(COMMAND[50:])


@pytest.mark.parametrize("torque", [None, 0.1 + COMMAND])
def test_commands_come_back_from_a_file(tmp_path, torque):
    Recording.from_arrays(TIME, POSITION, torque, command=COMMAND).save(tmp_path / "run.parquet")

    back = Recording.load(tmp_path / "run.parquet")

    assert back.command == pytest.approx(COMMAND)
    assert back.has_torque == (torque is not None)


def test_rows_without_command_are_left_out():
    command = COMMAND.copy()
    command[7, 1] = np.nan

    recording = Recording.from_arrays(TIME, POSITION, command=command)

    assert [item.rows for item in recording.left_out] == [(7,)]
    assert len(recording) == TIME.size - 1


def test_what_has_neither_is_refused():
    with pytest.raises(RecordingError, match="neither torques nor commands"):
        Recording.from_arrays(TIME, POSITION)


def test_a_command_of_fewer_joints_is_refused(tmp_path):
    with pytest.raises(ShapeError, match="command"):
        Recording.from_arrays(TIME, POSITION, command=COMMAND[:, :1])
    path = tmp_path / "run.csv"
    path.write_text("time,position_1,position_2,command_1\n0.0,0.1,0.1,0.2\n")
    with pytest.raises(RecordingError, match="lacks command_2"):
        Recording.load(path)


def test_commands_in_degrees_are_refused():
    with pytest.raises(RecordingError, match=r"command_1 .* rad; is it in degrees"):
        Recording.from_arrays(TIME, POSITION, command=1e4 * (1.1 + COMMAND))


VELOCITY = ("command_velocity",) * 2
MIXED = ("command", "command_velocity")
PUSHED = ("command_torque",) * 2


@pytest.mark.parametrize("channels", [VELOCITY, MIXED, PUSHED, ("command_torque", "command")])
def test_what_else_is_told_comes_back_from_a_file(tmp_path, channels):
    Recording.from_arrays(TIME, POSITION, command=COMMAND, channels=channels).save(
        tmp_path / "run.parquet"
    )

    back = Recording.load(tmp_path / "run.parquet")

    assert back.channels == channels
    assert back.command == pytest.approx(COMMAND)
    assert not back.has_torque
    assert not back.warnings


def test_a_joint_that_is_told_nothing_is_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,position_1,position_2,command_velocity_2\n0.0,0.1,0.1,0.2\n")
    with pytest.raises(RecordingError, match="lacks command_velocity_1"):
        Recording.load(path)


@pytest.mark.parametrize("channels", [VELOCITY, PUSHED])
def test_beside_torques_what_else_is_told_is_kept(tmp_path, channels):
    told = {channels[0]: COMMAND}
    Recording.from_arrays(TIME, POSITION, 0.1 + COMMAND, extras=told).save(tmp_path / "a.parquet")

    back = Recording.load(tmp_path / "a.parquet")

    assert back.command is None
    assert back.has_torque
    led = back.led(channels)
    assert led.channels == channels
    assert led.command == pytest.approx(COMMAND)


def test_torques_that_nobody_commands_are_refused():
    message = "command_torque_1 is beyond ±1e.06 .*; is it in N mm or mA"
    with pytest.raises(RecordingError, match=message):
        Recording.from_arrays(TIME, POSITION, command=1e7 + COMMAND, channels=PUSHED)


def test_a_drive_gets_its_own_channel_or_is_told_what_lacks():
    both = Recording.from_arrays(
        TIME, POSITION, command=COMMAND, extras={"command_velocity": 2.0 * COMMAND}
    )
    led = both.led((None, "command_velocity"))
    assert led.channels == MIXED
    assert led.command[:, 0] == pytest.approx(COMMAND[:, 0])
    assert led.command[:, 1] == pytest.approx(2.0 * COMMAND[:, 1])

    alone = Recording.from_arrays(TIME, POSITION, command=COMMAND)
    message = (
        r"lacks command_velocity_2: the drive of joint 2 takes rad/s, and what was recorded is "
        r"command_2 \[rad\]"
    )
    with pytest.raises(RecordingError, match=message):
        alone.led((None, "command_velocity"))


def test_a_command_that_is_no_number_somewhere_does_not_lack():
    told = COMMAND.copy()
    told[3, 1] = np.nan
    both = Recording.from_arrays(TIME, POSITION, command=COMMAND, extras={"command_velocity": told})
    with pytest.raises(RecordingError, match="command_velocity_2 is no number in 1 rows"):
        both.led((None, "command_velocity"))


def test_a_wheel_that_turns_on_is_no_arm_in_degrees():
    turned = 3.0 * TIME[:, None] * np.array([1.0, 2.0])
    recording = Recording.from_arrays(TIME, turned, command=3.0 + COMMAND, channels=VELOCITY)
    assert not recording.warnings


def test_a_wheel_may_turn_for_long_and_turn_the_other_way():
    told = 20.0 * np.sign(np.sin(2.0 * TIME))[:, None] * np.array([1.0, 0.5])
    turned = np.cumsum(told / 50.0, axis=0) + np.array([0.0, 5000.0])

    recording = Recording.from_arrays(TIME, turned, command=told, channels=VELOCITY)

    assert not recording.left_out
    with pytest.raises(RecordingError, match="position_2 is beyond ±1000 in 100% of the rows"):
        Recording.from_arrays(TIME, turned, command=told, channels=MIXED[::-1])


def test_a_spike_of_a_wheel_is_left_out():
    told = 2.0 + 0.0 * COMMAND
    turned = 2.0 * TIME[:, None] * np.ones(2)
    turned[80, 1] += 1.0

    recording = Recording.from_arrays(TIME, turned, command=told, channels=VELOCITY)

    assert [item.rows for item in recording.left_out] == [(80,)]


@pytest.mark.parametrize("channels", [("command",), ("command", "torque")])
def test_channels_that_are_none_are_refused(channels):
    with pytest.raises((RecordingError, ShapeError), match="channel"):
        Recording.from_arrays(TIME, POSITION, command=COMMAND, channels=channels)


@pytest.mark.parametrize("other", ["none", "empty"])
def test_a_drive_gets_its_own_channel_where_few_joints_have_both(tmp_path, other):
    columns = {"time": TIME, "position_1": POSITION[:, 0], "position_2": POSITION[:, 1]}
    columns |= {f"command_velocity_{j}": COMMAND[:, 0] for j in (1, 2)}
    columns["command_1"] = POSITION[:, 0] + 0.01 * TIME
    if other == "empty":
        columns["command_2"] = np.full(TIME.size, np.nan)
    pq.write_table(pa.table(columns), tmp_path / "run.parquet")

    recording = Recording.load(tmp_path / "run.parquet")

    assert recording.channels == MIXED
    assert recording.led(VELOCITY).command == pytest.approx(COMMAND)
    recording.led(VELOCITY).save(tmp_path / "led.parquet")
    back = Recording.load(tmp_path / "led.parquet")
    assert back.led(VELOCITY).command == pytest.approx(COMMAND)
    assert back.led(MIXED).command == pytest.approx(recording.command)
