"""Others on the bus of a CiA 402 arm, joints that do not follow, and a bus that takes no frame."""

import struct
from contextlib import suppress
from dataclasses import replace

import can
import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot
from backends.can.cia402.codec import MEASURED
from limo_driver.errors import BackendError, ConfigError, ConnectionLostError, HoldingError
from limo_driver.types import PositionCommand, TorqueCommand

PERIOD = 0.01  # [s]
NOTICED = max(0.02, 3 * PERIOD)  # [s]


@pytest.fixture
def bus():
    return SyncBus()


@pytest.fixture
def config():
    return arm_config(hold_after=20, rate=1 / PERIOD)


@pytest.fixture
def arm(bus, config):
    with CanopenArm(bus, NODES, counts_at(config, START)) as drives:
        yield drives


@pytest.fixture
def robot(bus, config, arm):  # noqa: ARG001  # it has to be there
    with CanRobot(config, bus=bus, clock=bus.now) as opened:
        yield opened


class Motion:
    """A motion of all joints that is slowly begun."""

    def __init__(self, robot, speed=0.3):
        self.robot, self.speed, self.v = robot, speed, 0.0
        self.state = robot.receive()
        self.q = np.array(self.state.position)

    def run(self, cycles):
        """Go on; return the state and how many cycles passed before it held."""
        for k in range(cycles):
            self.v = min(self.v + 2.0 * PERIOD, self.speed)
            self.q = self.q + self.v * PERIOD
            with suppress(HoldingError):
                self.robot.send(PositionCommand(position=self.q))
            self.state = self.robot.receive()
            if self.state.holding:
                return k
        return cycles

    def rest(self):
        """Let the arm come to rest."""
        for _ in range(40):
            self.state = self.robot.receive()
        assert self.robot.standing


def reason(robot):
    return robot._contract.save().reason


def targets(bus, joint=1):
    """Return the counts that a joint was told, one for each SYNC."""
    rows, row = [], None
    for frame_id, data in bus.sent:
        if frame_id == 0x200 + NODES[joint - 1]:
            row = struct.unpack("<Hih", data)[1]
        elif frame_id == 0x080 and row is not None:
            rows.append(row)
    return np.array(rows)


def check_steps(bus, config, joint=1):
    """No step is wider than the joint may move, and no change of velocity harder."""
    counts = abs(config.joints[joint - 1].counts_per_radian)
    path, limits = targets(bus, joint), config.model.limits
    assert np.abs(np.diff(path)).max() <= limits.velocity[joint - 1] * counts * PERIOD + 1
    change = np.abs(np.diff(path, n=2)).max()
    assert change <= limits.acceleration[joint - 1] * counts * PERIOD**2 + 3


FOREIGN = {
    "SYNC": (0x080, b"", r"heard SYNC \(frame 080\)"),
    "set-point": (0x200 + NODES[2], struct.pack("<Hih", 0x0F, 0, 0), "a set-point of joint 3"),
    "torque": (0x300 + NODES[6], struct.pack("<hb", 9, 10), "a set-point of joint 7"),
    "third": (0x400 + NODES[0], bytes(8), "a set-point of joint 1"),
    "heartbeat": (0x77F, b"\x05", r"its heartbeat \(frame 77F\)"),
}


class TestOthers:
    @pytest.mark.parametrize("echo", [False, True])
    @pytest.mark.parametrize("what", FOREIGN)
    def test_are_noticed_while_the_arm_moves(self, bus, config, what, echo):
        bus.echo = echo
        with (
            CanopenArm(bus, NODES, counts_at(config, START)),
            CanRobot(config, bus=bus, clock=bus.now) as robot,
        ):
            motion = Motion(robot)
            assert motion.run(60) == 60
            frame_id, data, said = FOREIGN[what]
            bus.sent.clear()
            bus.deliver(frame_id, data)
            heard = bus.now()
            motion.run(20)
            assert bus.now() - heard <= NOTICED + 1e-9
            with pytest.raises(HoldingError, match=f"another program commands .*{said}"):
                robot.send(PositionCommand(position=motion.q))
            motion.rest()
            check_steps(bus, config)
            with pytest.raises(BackendError, match=r"another program.*call reset_faults"):
                robot.resume()
            robot.reset_faults()
            robot.resume()
            assert Motion(robot).run(5) == 5

    @pytest.mark.parametrize("frame_id", [0x200 + 99, 0x600 + NODES[0], 0x000, 0x100, 0x77E])
    def test_may_talk_of_other_things(self, bus, robot, frame_id):
        motion = Motion(robot)
        motion.run(10)
        bus.deliver(frame_id, bytes(8))
        assert motion.run(20) == 20

    @pytest.mark.usefixtures("arm")
    def test_that_send_what_this_program_sent_are_told_from_an_echo(self, bus, config):
        """The very same frame, once more than it was sent."""
        bus.echo = True
        with CanRobot(config, bus=bus, clock=bus.now) as robot:
            motion = Motion(robot)
            motion.run(20)
            last = next(data for frame_id, data in reversed(bus.sent) if frame_id == 0x20B)
            bus.deliver(0x20B, last)
            assert motion.run(10) < 3
            assert "a set-point of joint 1" in reason(robot)


class TestASecondNode:
    @pytest.mark.parametrize(("cycles", "holds"), [(1, False), (2, True), (20, True)])
    def test_under_the_id_of_a_drive_is_named(self, bus, config, arm, robot, cycles, holds):
        motion, left = Motion(robot), [0]
        motion.run(30)
        listener = bus.listener

        def doubled(frame_id, data):
            listener(frame_id, data)
            if frame_id == 0x080 and left[0]:
                left[0] -= 1
                bus.deliver(0x180 + NODES[4], MEASURED.pack(0x27, arm.drives[4].count + 40, 0))

        bus.listener, left[0], began = doubled, cycles, bus.now()
        bus.sent.clear()
        motion.run(15)
        assert motion.state.holding == holds
        if holds:
            assert bus.now() - began <= NOTICED + 1e-9
            assert "joint 5 (node 15) answers twice" in reason(robot)
            assert "a second node has its id" in reason(robot)
            motion.rest()
            check_steps(bus, config)

    def test_is_none_where_an_answer_was_late(self, bus, arm, robot):
        motion = Motion(robot)
        motion.run(10)
        for k in range(20):
            arm.drives[2].mute = True
            motion.run(1)  # its answer comes with the next one
            arm.drives[2].mute = False
            bus.deliver(0x180 + NODES[2], MEASURED.pack(0x27, arm.drives[2].count, 0))
            motion.run(1 + k % 2)
        assert not motion.state.holding


class TestAJointThatDoesNotFollow:
    def stuck(self, arm, joint):
        """Let a drive stand still, whatever it is told."""
        drive = arm.drives[joint - 1]
        where, step = drive.count, drive._step_state

        def stay():
            step()
            drive.target = where + drive.lag

        drive._step_state = stay
        return where

    @pytest.mark.parametrize("speed", [0.1, 0.5, 1.2])
    @pytest.mark.parametrize("j", [1, 4])
    def test_holds_once_it_is_off_its_latest_set_points(self, bus, config, arm, robot, j, speed):
        motion, joint = Motion(robot, speed), j
        assert motion.run(80) == 80
        bus.sent.clear()
        where = self.stuck(arm, joint)
        cycles = motion.run(200)
        assert f"joint {joint} (node {NODES[joint - 1]}) does not follow" in reason(robot)
        counts = config.joints[joint - 1].counts_per_radian
        off = abs((targets(bus, joint) - where) / counts)
        outside = np.flatnonzero(off > config.following_error)[0]
        assert (cycles - outside) * PERIOD <= NOTICED + 1e-9
        assert off[-4] > config.following_error  # and not before
        motion.rest()
        check_steps(bus, config, joint)

    @pytest.mark.parametrize(("share", "holds"), [(0.98, False), (1.02, True)])
    @pytest.mark.parametrize("sign", [-1, 1])
    def test_may_be_off_by_so_much(self, config, arm, robot, share, holds, sign):
        motion = Motion(robot, speed=0.0)
        motion.run(5)
        counts = abs(config.joints[0].counts_per_radian)
        arm.drives[0].lag = sign * round(share * config.following_error * counts)
        motion.run(5)
        assert motion.state.holding == holds

    def test_may_be_behind_by_20_ms_or_three_cycles_beyond_that(self, config, arm, robot):
        motion = Motion(robot, speed=1.2)
        assert motion.run(80) == 80
        counts = config.joints[0].counts_per_radian
        for late, holds in ((2.5, False), (4.5, True)):
            away = config.following_error + late * 1.2 * PERIOD
            for share in np.linspace(0.1, 1.0, 10):
                arm.drives[0].lag = round(share * away * counts)
                motion.run(1)
            assert motion.state.holding == holds

    def test_says_so_itself(self, arm, robot):
        motion = Motion(robot)
        motion.run(5)
        transmit = arm.drives[3]._transmit
        arm.drives[3]._transmit = lambda number, first, *rest: transmit(
            number, first | (0x2000 if number == 1 else 0), *rest
        )
        assert motion.run(5) <= 1
        assert "joint 4 (node 14) does not follow, as it says itself" in reason(robot)

    def test_is_told_to_its_drive(self, bus, config):
        with CanopenArm(bus, NODES, counts_at(config, START)):
            heard = []
            listener = bus.listener

            def noted(frame_id, data):
                if frame_id == 0x600 + NODES[0] and data[1:3] in {b"\x65\x60", b"\x66\x60"}:
                    heard.append((data[1:3].hex(), int.from_bytes(data[4:], "little")))
                listener(frame_id, data)

            bus.listener = noted
            with CanRobot(config, bus=bus, clock=bus.now):
                pass
        window = config.following_error + config.model.limits.velocity[0] * NOTICED
        counts = window * abs(config.joints[0].counts_per_radian)
        assert heard == [("6560", pytest.approx(counts, abs=1)), ("6660", 30)]


class Refusing:
    """Lets a bus take no frame, from one of them on."""

    def __init__(self, bus):
        self.bus, self.plain, self.left, self.passes = bus, bus.send, 0, 0
        bus.send = self.send

    def send(self, msg, timeout=None):
        if self.left and not self.passes:
            self.left -= 1
            raise can.CanOperationError("Failed to transmit: No buffer space available", 105)
        self.passes = max(self.passes - 1, 0)
        self.plain(msg, timeout)


class TestABusThatTakesNoFrame:
    @pytest.mark.parametrize("passes", [0, 3, 6, 7])
    @pytest.mark.parametrize("failures", [1, 2, 5])
    def test_loses_no_set_point(self, bus, config, robot, passes, failures):
        motion = Motion(robot)
        motion.run(60)
        refusing = Refusing(bus)
        refusing.left, refusing.passes = failures, passes
        for k in range(failures):
            with pytest.raises(ConnectionLostError, match="takes no frame"):
                motion.run(1)
            sent = robot.send(PositionCommand(position=motion.q + (-0.01 if k % 2 else 0.01)))
            assert sent.limited_by[-1] == "link"
        motion.run(60)
        check_steps(bus, config)

    @pytest.mark.parametrize("passes", [0, 5, 9, 14])
    @pytest.mark.parametrize("failures", [1, 2])
    def test_keeps_the_drives_in_torque_mode(self, bus, robot, passes, failures):
        robot.receive()
        for k in range(10):
            robot.send(TorqueCommand(torque=np.full(7, 0.1 * k)))
            robot.receive()
        refusing = Refusing(bus)
        refusing.left, refusing.passes = failures, passes
        bus.sent.clear()
        for _ in range(failures):
            robot.send(TorqueCommand(torque=np.full(7, 1.0)))
            with pytest.raises(ConnectionLostError, match="takes no frame"):
                robot.receive()
        robot.receive()
        told = [data for frame_id, data in bus.sent if frame_id == 0x300 + NODES[0]]
        assert {struct.unpack("<hb", data)[1] for data in told} == {10}

    @pytest.mark.parametrize(("pause", "holds"), [(0.025, False), (0.035, True)])
    def test_holds_once_that_took_long(self, bus, robot, pause, holds):
        motion = Motion(robot)
        motion.run(60)
        refusing = Refusing(bus)
        refusing.left = 1
        with pytest.raises(ConnectionLostError):
            motion.run(1)
        robot._due = bus.now() + pause  # the program comes back then
        motion.run(1)
        assert motion.state.holding == holds
        if holds:
            assert "took no frame for 0.035 s" in reason(robot)


def test_a_limit_of_following_has_to_be_one():
    with pytest.raises(ConfigError, match="following_error"):
        replace(arm_config(), following_error=0.0)
