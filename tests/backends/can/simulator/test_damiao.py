"""Damiao's frames, and the simulated motor behind them."""

from dataclasses import replace

import numpy as np
import pytest
from bus_master import Master
from hypothesis import given
from hypothesis import strategies as st

from backends.can.config import ArmConfig
from backends.can.damiao import codec as damiao
from backends.can.damiao.codec import MitCommand, Ranges, Reply, Status
from limo_driver.errors import ConfigError, WireFormatError

RANGES = Ranges(12.5, 30.0, 10.0)
JOINTS = """
  - {node: 1}
  - {node: 2, direction: -1, offset: 0.25}
"""


def floats(limit, lower=None):
    return st.floats(-limit if lower is None else lower, limit)


commands = st.builds(
    MitCommand, floats(12.5), floats(30.0), floats(500.0, 0), floats(5.0, 0), floats(10.0)
)


@given(commands)
def test_a_command_comes_back_within_half_a_step(command):
    back = damiao.decode_command(damiao.encode_command(command, RANGES), RANGES)
    for name, span, steps in (
        ("position", 25.0, 65535),
        ("velocity", 60.0, 4095),
        ("stiffness", 500.0, 4095),
        ("damping", 5.0, 4095),
        ("torque", 20.0, 4095),
    ):
        error = abs(getattr(back, name) - getattr(command, name))
        assert error <= 0.5 * span / steps * (1 + 1e-9)


@given(st.integers(0, 15), st.integers(0, 15), floats(12.5), floats(30.0), floats(10.0))
def test_a_reply_comes_back_within_half_a_step(status, motor, position, velocity, torque):
    reply = Reply(status, motor, position, velocity, torque, 41, 57)
    back = damiao.decode_reply(damiao.encode_reply(reply, RANGES), RANGES)
    assert (back.status, back.motor, back.transistors, back.winding) == (status, motor, 41, 57)
    assert back.position == pytest.approx(position, abs=0.51 * 25 / 65535)
    assert back.velocity == pytest.approx(velocity, abs=0.51 * 60 / 4095)
    assert back.torque == pytest.approx(torque, abs=0.51 * 20 / 4095)


def test_bytes_are_those_of_the_manual():
    # Highest and lowest codes, where nothing depends on rounding.
    most = MitCommand(12.5, -30.0, 500.0, 0.0, 10.0)
    assert damiao.encode_command(most, RANGES).hex() == "ffff000fff000fff"
    assert damiao.encode_reply(Reply(1, 3, -12.5, 30.0, -10.0, 25, 26), RANGES).hex() == (
        "130000fff000191a"
    )
    assert damiao.ENABLE.hex() == "ff" * 7 + "fc"
    assert damiao.register_frame(0x105, damiao.READ, 21).hex() == "0501331500000000"
    assert damiao.register_frame(5, damiao.WRITE, 10, 1).hex() == "0500550a01000000"
    assert damiao.decode_register(bytes.fromhex("0500331500004841")) == (5, 0x33, 21, 12.5)


def test_values_beyond_the_ranges_are_cut_to_them():
    far = MitCommand(99.0, -99.0, 999.0, 9.0, -99.0)
    assert damiao.encode_command(far, RANGES).hex() == "ffff000ffffff000"


def test_no_command_is_one_of_the_special_frames():
    most = MitCommand(1e9, 1e9, 1e9, 1e9, 1e9)
    data = damiao.encode_command(most, RANGES)
    assert data not in {damiao.ENABLE, damiao.DISABLE, damiao.ZERO, damiao.CLEAR}
    assert data[:7] != b"\xff" * 7
    assert damiao.decode_command(data, RANGES).damping == pytest.approx(5.0, abs=2e-3)


@pytest.mark.parametrize("length", [0, 7, 9, 64])
def test_frames_of_another_length_are_refused(length):
    for decode in (damiao.decode_command, damiao.decode_reply):
        with pytest.raises(WireFormatError, match="8 bytes"):
            decode(bytes(length), RANGES)
    with pytest.raises(WireFormatError, match="8 bytes"):
        damiao.decode_register(bytes(length))


@pytest.fixture
def motors(arm_yaml):
    master = Master(ArmConfig.load(arm_yaml("convention: damiao", JOINTS)), position=[0.4, -0.3])
    yield master
    master.station.close()


def reply_of(motors, data, node=1):
    ranges = motors.station.drives[node - 1].ranges
    [(frame_id, answer)] = motors.say(node, data)
    assert frame_id == node + 0x10
    return damiao.decode_reply(answer, ranges)


def command(motors, node=1, **values):
    given = {"position": 0.0, "velocity": 0.0, "stiffness": 0.0, "damping": 0.0, "torque": 0.0}
    ranges = motors.station.drives[node - 1].ranges
    return damiao.encode_command(MitCommand(**{**given, **values}), ranges)


def test_a_joint_without_a_torque_limit_gives_a_simulated_motor_no_range(arm_yaml, monkeypatch):
    config = ArmConfig.load(arm_yaml("convention: damiao", JOINTS))
    limits = replace(config.model.limits, torque=np.array([50.0, np.inf]))
    monkeypatch.setattr(config.model, "limits", limits)
    with pytest.raises(ConfigError, match=r"no torque limit of joint 2 is stated in .*two_links"):
        Master(config, position=[0.4, -0.3])


def test_a_motor_says_nothing_until_it_is_spoken_to(motors):
    assert motors.heard == []
    assert motors.wait(0.1) == []


def test_somebody_holds_the_arm_until_it_is_first_enabled(motors):
    motors.wait(1.0)
    where = [port.measured_position for port in motors.station.arm.joints]
    assert where == pytest.approx([0.4, -0.3], abs=2e-3)


def test_it_is_enabled_and_disabled_and_says_so(motors):
    assert reply_of(motors, damiao.ENABLE).status == Status.ENABLED
    assert reply_of(motors, damiao.DISABLE).status == Status.DISABLED
    assert reply_of(motors, command(motors)).status == Status.DISABLED  # does not enable


def test_its_zero_can_be_set_while_it_is_off(motors):
    assert reply_of(motors, damiao.ZERO).position == pytest.approx(0.0, abs=1e-3)
    reply_of(motors, damiao.ENABLE)
    before = reply_of(motors, command(motors)).position
    assert reply_of(motors, damiao.ZERO).position == pytest.approx(before, abs=1e-3)  # not now


def test_its_reply_is_of_the_motor_with_its_sign_and_offset(motors):
    reply = reply_of(motors, damiao.ENABLE, node=2)
    assert reply.position == pytest.approx(0.25 - -0.3, abs=2e-3)
    assert reply.motor == 2


def test_it_follows_a_spring_and_falls_without_one(motors):
    reply_of(motors, damiao.ENABLE)
    reply_of(motors, damiao.ENABLE, node=2)
    for _ in range(200):
        reply_of(motors, command(motors, position=0.4, stiffness=500, damping=5))
        reply_of(motors, command(motors, 2, position=0.55, stiffness=500, damping=5), node=2)
        motors.wait(0.01)
    held = motors.station.arm.joints[0].measured_position
    assert held == pytest.approx(0.4, abs=0.05)  # sags under its load, without feed-forward
    reply_of(motors, damiao.DISABLE)
    motors.wait(0.5)
    assert abs(motors.station.arm.joints[0].measured_position - held) > 0.1


def test_it_switches_off_when_commands_cease(motors):
    motors.say(0x7FF, damiao.register_frame(1, damiao.WRITE, 9, 1000))  # 50 ms
    reply_of(motors, damiao.ENABLE)
    motors.wait(0.045)
    assert reply_of(motors, command(motors)).status == Status.ENABLED
    motors.wait(0.1)
    assert reply_of(motors, command(motors)).status == Status.LOST_COMMUNICATION
    assert reply_of(motors, damiao.ENABLE).status == Status.LOST_COMMUNICATION  # cleared first
    assert reply_of(motors, damiao.CLEAR).status == Status.DISABLED


def test_registers_are_read_and_only_some_written(motors):
    [(frame_id, answer)] = motors.say(0x7FF, damiao.register_frame(1, damiao.READ, 23))
    assert frame_id == 0x11
    assert damiao.decode_register(answer) == (1, damiao.READ, 23, 62.5)  # 1.25 x 50 N m
    [(_, answer)] = motors.say(0x7FF, damiao.register_frame(1, damiao.WRITE, 23, 1.0))
    assert damiao.decode_register(answer)[-1] == 62.5
    assert motors.say(0x7FF, damiao.register_frame(9, damiao.READ, 23)) == []


@given(data=st.binary(max_size=8), frame_id=st.sampled_from([1, 2, 0x7FF]))
def test_any_bytes_leave_it_sane(shared_motors, frame_id, data):
    shared_motors.say(frame_id, data)
    for drive in shared_motors.station.drives:
        assert drive.status in set(Status)


@pytest.fixture(scope="module")
def shared_motors(tmp_path_factory, two_links_urdf):
    path = tmp_path_factory.mktemp("arm") / "arm.yaml"
    path.write_text(
        "bus: {interface: virtual, channel: unused}\nconvention: damiao\n"
        f"robot: {two_links_urdf}\njoints:{JOINTS}"
    )
    return Master(ArmConfig.load(path))
