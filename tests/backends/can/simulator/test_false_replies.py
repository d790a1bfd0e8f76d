"""False replies of Damiao motors move no torque faster than it may."""

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest

from backends.can import CanRobot
from backends.can.damiao import codec as damiao
from limo_driver.errors import BackendError, HoldingError
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

FALSE = 0.5  # [rad]


@pytest.fixture
def robot(config, bus):
    with CanRobot(config, bus=bus, clock=bus.now) as opened:
        yield opened


def lying(bus, cycles, joint=1, away=FALSE):
    """Let the next replies of a joint have it elsewhere [rad]."""
    deliver, left = bus.deliver, [cycles]
    ranges = bus.station.drives[joint - 1].ranges

    def spoiled(frame_id, data, **kind):
        if frame_id == 0x10 + joint and left[0] and len(data) == 8:
            left[0] -= 1
            code = int.from_bytes(data[1:3], "big") + round(away / ranges.position * 32767.5)
            data = data[:1] + code.to_bytes(2, "big") + data[3:]
        deliver(frame_id, data, **kind)

    bus.deliver = bus.station._port.send = spoiled


def told(bus, joint=1):
    ranges = bus.station.drives[joint - 1].ranges
    sent = [data for frame_id, data in bus.sent if frame_id == joint]
    return [damiao.decode_command(data, ranges) for data in sent if data[:7] != b"\xff" * 7]


def command(kind, start):
    zero = np.zeros(2)
    if kind == "position":
        return PositionCommand(position=start)
    if kind == "torque":
        return TorqueCommand(torque=zero)
    return ImpedanceCommand(
        position=start, stiffness=zero + 100.0, damping=zero + 2.0, torque=zero
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["position", "impedance", "torque", "hold", "idle"])
@pytest.mark.parametrize("cycles", [1, 2, 3, 40])
def test_change_no_torque_faster_than_its_rate(robot, bus, config, kind, cycles):
    start = robot.receive().position
    for _ in range(20):
        if kind in {"position", "impedance", "torque"}:
            robot.send(command(kind, start))
        if kind == "hold":
            robot.hold()
        robot.receive()
    bus.sent.clear()
    lying(bus, cycles)
    gives_way = kind in {"impedance", "torque"}
    patience = 2 if gives_way else 3  # replies; an arm that gives way holds after 10 ms of none
    for k in range(60):
        if kind in {"position", "impedance", "torque"}:
            with suppress(HoldingError):
                robot.send(command(kind, start))
        state = robot.receive()
        if k < min(cycles, patience):
            assert state.holding == (kind == "hold" or (k + 1 == patience and kind != "idle"))
    assert state.holding == (kind == "hold" or (cycles >= patience and kind != "idle"))
    if cycles >= patience and kind in {"position", "impedance", "torque"}:
        why = "no measurement" if gives_way else "the measured pose jumped"
        with pytest.raises(HoldingError, match=why):
            robot.send(command(kind, start))
    heard = told(bus)
    torque = np.array([each.torque for each in heard])
    ranges = bus.station.drives[0].ranges
    most = config.model.limits.torque_rate[0] / config.rate
    assert np.abs(np.diff(torque)).max() <= most + 1.01 * ranges.torque_step
    if cycles < patience and kind != "torque":
        gravity = config.model.gravity_torque(start)[0][0]
        assert torque == pytest.approx(np.full(len(torque), gravity), abs=0.5)


@pytest.mark.parametrize("cycles", [3, 6, 40])
@pytest.mark.parametrize(
    ("kind", "away"),
    [("position", FALSE), ("impedance", FALSE), ("torque", FALSE), ("torque", 0.04)],
)
def test_change_no_torque_where_the_arm_is_faster_than_its_rate(
    robot, bus, config, kind, cycles, away
):
    """As stiffness about a false pose would, or a torque that an arm at that pose would have.

    Also where the arm can have got to, so that it is believed at once.
    """
    start = robot.receive().position
    for _ in range(20):
        robot.send(command(kind, start))
        robot.receive()
    bus.sent.clear()
    lying(bus, cycles, away=away)
    where = []
    for k in range(100):
        where.append(bus.station.arm.encoders[0])
        if k == 5:
            robot.hold()
        with suppress(BackendError):
            robot.send(command("torque" if k > 5 else kind, start))
        if robot.receive().holding:
            with suppress(BackendError):
                robot.resume()

    def torque(said, position):
        return (
            said.stiffness * (said.position - position) + said.damping * said.velocity + said.torque
        )

    sent, ranges = told(bus), bus.station.drives[0].ranges
    pairs = zip(where[1:], pairwise(sent), strict=True)
    changes = [torque(after, q) - torque(before, q) for q, (before, after) in pairs]
    rounding = 1.5 * 500 * 2 * ranges.position / 65535  # of two that are said, one that is measured
    most = config.model.limits.torque_rate[0] / config.rate
    assert np.abs(changes).max() <= most + ranges.torque_step + rounding


def test_an_arm_that_lied_takes_commands_once_it_is_back(robot, bus):
    start = robot.receive().position
    robot.send(command("torque", start))
    lying(bus, 20)
    for _ in range(10):
        robot.receive()
    with pytest.raises(BackendError, match=r"joint 1 is measured 0\..* rad from where it can be"):
        robot.resume()
    for _ in range(20):
        robot.receive()
    robot.resume()
    robot.send(command("position", start))


def test_gravity_is_led_to_where_the_arm_insists_that_it_is(robot, bus, config):
    """Where three replies in a row agree, at the rate of torques."""
    start = robot.receive().position
    robot.send(PositionCommand(position=start))
    robot.receive()
    lying(bus, 10**6)
    for _ in range(60):
        robot.receive()
    there = config.model.gravity_torque(start + np.array([FALSE, 0.0]))[0][0]
    assert told(bus)[-1].torque == pytest.approx(there, abs=0.5)


def test_gravity_is_rate_limited_also_while_motors_are_enabled(robot, bus, config):
    robot.receive()
    bus.sent.clear()
    bus.station.drives[1].fail(damiao.Status.OVERCURRENT)
    robot.receive()
    lying(bus, 1)
    robot.reset_faults()
    torque = np.array([each.torque for each in told(bus)])
    most = config.model.limits.torque_rate[0] / config.rate
    assert np.abs(np.diff(torque)).max() <= most + 0.1
