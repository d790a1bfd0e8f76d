"""The driver of Damiao motors, on a bus with a time of its own."""

from contextlib import suppress
from dataclasses import replace

import can
import numpy as np
import pytest
from bus_master import POSE, DrivesBus

from backends.can import CanRobot
from backends.can.config import DamiaoJoint
from backends.can.damiao import codec as damiao
from backends.can.damiao.codec import Register, Status
from limo_driver.errors import BackendError, ConfigError, HoldingError, JointLimitError
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand


def opened(config, bus, **options):
    return CanRobot(config, bus=bus, clock=bus.now, **options)


def registers(bus, joint):
    return bus.station.drives[joint - 1]._registers


def test_ranges_are_read_from_the_motors(config, bus):
    for joint, torque in ((1, 28.0), (2, 40.0)):
        registers(bus, joint)[Register.TORQUE_RANGE] = torque
    with opened(config, bus) as robot:
        assert robot.spec.torque_resolution == pytest.approx([56 / 4095, 80 / 4095])


def test_the_watchdog_and_the_mode_are_set(config, bus):
    registers(bus, 1)[Register.MODE] = 2
    with opened(config, bus):
        assert registers(bus, 1)[Register.MODE] == damiao.MIT_MODE
        assert registers(bus, 2)[Register.TIMEOUT] * 50e-6 == pytest.approx(config.watchdog)


def test_nothing_moves_before_a_command(config, bus):
    with opened(config, bus) as robot:
        first = robot.receive()
        for _ in range(200):
            state = robot.receive()
        assert first.position == pytest.approx(POSE, abs=2e-3)
        assert state.position == pytest.approx(first.position, abs=5e-3)  # gravity is compensated


def test_a_position_is_followed(config, bus):
    with opened(config, bus) as robot:
        state = robot.receive()
        start = state.position
        for k in range(1, 401):
            robot.send(PositionCommand(position=start + 0.1 * (1 - np.cos(np.pi * k / 400))))
            state = robot.receive()
        assert state.position == pytest.approx(start + 0.2, abs=0.01)
        assert np.isfinite(state.velocity).all()
        assert [drive.temperature for drive in robot.drives] == [25.0, 25.0]
        state = robot.receive()
        assert state.temperature.tolist() == [25.0, 25.0]
        assert state.drives == ("enabled", "enabled")


def test_motors_that_lose_their_master_switch_off(config, bus):
    with opened(config, bus) as robot:
        robot.receive()
        bus.time += 1.0
        bus.station.turn()
        assert [drive.status for drive in bus.station.drives] == [Status.LOST_COMMUNICATION] * 2
        state = robot.receive()
        with pytest.raises(HoldingError, match=r"joint 1 .* 'lost communication'"):
            robot.send(PositionCommand(position=state.position))
        robot.reset_faults()
        robot.resume()
        robot.send(PositionCommand(position=robot.receive().position))


def test_motors_in_fault_are_not_reset_unless_told(config, bus):
    bus.station.drives[1].fail(Status.OVERCURRENT)
    with (
        opened(config, bus) as robot,
        pytest.raises(
            BackendError, match=r"joint 2 .*cannot be enabled: overcurrent; open with re"
        ),
    ):
        robot.receive()
    with opened(config, DrivesBus(config, POSE), reset_faults=True) as robot:
        robot.receive()


def test_an_arm_that_was_moved_by_hand_is_held_where_it_is(config, bus):
    with opened(config, bus) as robot:
        bus.station.arm._knots += 0.3  # somebody moves it, slowly
        until = bus.time + 3.0
        while bus.time < until:
            bus.recv(0.01)
        bus.queue.clear()
        bus.sent.clear()
        state = robot.receive()
        assert state.position == pytest.approx(np.array(POSE) + 0.3, abs=0.02)
        told = commands(bus, 1)
        assert told
        assert [each.position for each in told] == pytest.approx(
            [state.position[0]] * len(told), abs=0.01
        )


def test_gravity_is_that_of_where_the_arm_is_also_while_nothing_is_commanded(config, bus):
    places = set()
    with opened(config, bus) as robot:
        state = robot.receive()
        for k in range(30):  # away, and it settles there
            robot.send(PositionCommand(position=state.position + 2e-3 * min(k, 10)))
            robot.receive()
        robot.hold()
        while not robot.standing:
            robot.receive()
        robot.resume()
        for _ in range(30):
            state = robot.receive()
            places.add(state.position.tobytes())
            carried = config.model.gravity_torque(state.position)[0]
            assert robot._link.gravity() == pytest.approx(carried, abs=1e-12)
    assert len(places) > 3


def commands(bus, node):
    """Return the commands that a motor was sent since it was last enabled."""
    sent = [data for frame_id, data in bus.sent if frame_id == node]
    if damiao.ENABLE in sent:
        sent = sent[len(sent) - sent[::-1].index(damiao.ENABLE) :]
    ranges = bus.station.drives[node - 1].ranges
    return [damiao.decode_command(data, ranges) for data in sent]


def test_the_others_are_held_while_a_motor_is_reset(config, bus):
    with opened(config, bus) as robot:
        robot.receive()
        for _ in range(10):
            robot.send(TorqueCommand(torque=np.zeros(2)))
            robot.receive()
        bus.station.drives[1].fail(Status.OVERCURRENT)
        robot.receive()
        bus.sent.clear()
        robot.reset_faults()
        stiffness = [command.stiffness for command in commands(bus, 1)]
        assert (np.diff(stiffness) >= 0.0).all()  # from none, as fast as torques may change
        assert stiffness[-1] == pytest.approx(500.0, abs=0.5)


def test_a_bus_that_was_off_is_used_again_when_told(config, bus):
    with opened(config, bus) as robot:
        state = robot.receive()
        robot.send(PositionCommand(position=state.position))
        bus.queue.append(can.Message(arbitration_id=0x40, is_error_frame=True))
        assert robot.receive().holding
        with pytest.raises(BackendError, match="too many errors"):
            robot.resume()
        robot.reset_faults()
        robot.resume()
        robot.send(PositionCommand(position=robot.receive().position))
        assert not robot.receive().holding


def test_closing_switches_the_motors_off(config, bus):
    with opened(config, bus) as robot:
        robot.receive()
    assert [drive.status for drive in bus.station.drives] == [Status.DISABLED] * 2


def test_a_motor_whose_range_is_too_small_is_refused(config, bus):
    registers(bus, 2)[Register.POSITION_RANGE] = 3.0
    with pytest.raises(BackendError, match=r"joint 2 .* spans 3 rad each way \(register 21\)"):
        opened(config, bus)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_a_range_that_is_none_is_refused(config, bus, value):
    registers(bus, 1)[Register.VELOCITY_RANGE] = value
    with pytest.raises(BackendError, match="register 22, which is no range"):
        opened(config, bus)


def test_a_motor_that_keeps_its_mode_is_refused(config, bus):
    bus.station.drives[0]._registers = Stubborn(registers(bus, 1))
    with pytest.raises(BackendError, match=r"joint 1 .* does not take 1 in register 10"):
        opened(config, bus)


class Stubborn(dict):
    def __init__(self, values):
        super().__init__(values)
        super().__setitem__(Register.MODE, 3)

    def __setitem__(self, register, value):
        if register != Register.MODE:
            super().__setitem__(register, value)


def test_ids_that_collide_are_refused(config, bus):
    joints = (DamiaoJoint(node=1), DamiaoJoint(node=0x11))
    with pytest.raises(ConfigError, match="joint 1 replies on 0x11, which joint 2 uses"):
        opened(replace(config, joints=joints), bus)


def test_an_impossible_rate_is_refused_with_the_arithmetic(config, bus):
    with pytest.raises(ConfigError, match=r"2 commands x 135 us x 2000 Hz = 54\.0 % \+ 2 replies"):
        opened(replace(config, rate=2000.0), bus)


def test_gains_that_the_frame_cannot_hold_are_refused(config, bus):
    gains = {"stiffness": np.array([100.0, 100.0]), "torque": np.zeros(2)}
    with opened(config, bus) as robot:
        position = robot.receive().position
        with pytest.raises(JointLimitError, match=r"joint 2: damping 5.1 N m s/rad is outside"):
            robot.send(ImpedanceCommand(position=position, damping=np.array([1.0, 5.1]), **gains))


def test_its_own_frames_are_no_replies(config, bus):
    bus.echo = True
    with opened(config, bus) as robot:
        for _ in range(20):
            state = robot.receive()
    assert state.position == pytest.approx(POSE, abs=5e-3)


def test_random_frames_do_no_harm(config, bus):
    random = np.random.default_rng(0)
    limits = config.model.limits
    with opened(config, bus) as robot:
        state = robot.receive()
        for _ in range(500):
            for _ in range(random.poisson(0.5)):
                frame_id = int(random.choice([0x11, 0x12, 1, 2, 0x7FF, random.integers(0x800)]))
                data = random.bytes(int(random.choice([0, 7, 8, 8, 8])))
                bus.deliver(frame_id, data)
                bus.station.hear(frame_id, data)
            bus.sent.clear()
            with suppress(BackendError):
                robot.send(PositionCommand(position=state.position))
            with suppress(BackendError):
                state = robot.receive()
            for frame_id, data in bus.sent:
                assert frame_id in {1, 2, 0x7FF}
                if frame_id in {1, 2} and data[:7] != b"\xff" * 7:
                    told = damiao.decode_command(data, bus.station.drives[frame_id - 1].ranges)
                    assert abs(told.torque) <= limits.torque[frame_id - 1] * 1.01
