"""A computer that stalls: not the silence of joints, not a faster motion, and said in the hold."""

import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot
from backends.can.cia402.codec import MEASURED
from limo_driver.errors import HoldingError
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.types import PositionCommand

PERIOD = 0.01  # [s]


class StallingBus(SyncBus):
    """Loses the processor around a SYNC; the drives, which had lost it too, answer afterwards."""

    def __init__(self):
        super().__init__()
        self.noise = self.before
        self.syncs = []  # when each was sent [s]
        self.oversleeps = 0.0  # [s], in the wait for answers
        self.hesitates = 0.0  # [s], between the beginning of a cycle and its SYNC
        self.arm = None

    def before(self):
        if self.sent[-1][0] != 0x080:
            return
        self.time += self.hesitates
        if self.oversleeps or self.hesitates:
            self.losing = 1  # its answers come later
            begun = self.time + (2 * PERIOD + self.oversleeps if self.oversleeps else 0.0)
            self.later = [
                (
                    begun + 0.2 * PERIOD,
                    0x180 + drive.node.id,
                    MEASURED.pack(0x27, drive.count, 0),
                )
                for drive in self.arm.drives
            ]
        self.hesitates = 0.0
        self.syncs.append(self.time)

    def recv(self, timeout=None):
        if self.oversleeps and self.syncs and timeout and self.later:
            self.time += timeout + self.oversleeps
            self.oversleeps = 0.0
            return None
        return super().recv(timeout)


@pytest.fixture
def bus():
    return StallingBus()


@pytest.fixture
def robot(bus):
    config = arm_config(hold_after=2, rate=1 / PERIOD)
    with (
        CanopenArm(bus, NODES, counts_at(config, START)) as bus.arm,
        CanRobot(config, bus=bus, clock=bus.now) as robot,
    ):
        state = robot.receive()
        for _ in range(5):
            robot.send(PositionCommand(position=state.position))
            robot.receive()
        yield robot


@pytest.mark.parametrize("stall", ["oversleeps", "hesitates"])
def test_a_stall_is_not_the_silence_of_joints(bus, robot, stall):
    for _ in range(4):
        setattr(bus, stall, 5 * PERIOD)
        state = robot.receive()
        assert not state.stale
        robot.send(PositionCommand(position=state.position))
    assert not robot.receive().holding
    assert robot.link_figures()["silent_cycles"] == 0
    assert robot.overruns >= 12


def test_a_joint_that_is_silent_holds_the_arm_and_nobody_else_is_blamed(bus, robot):
    bus.arm.drives[5].mute = True
    states = [robot.receive() for _ in range(2)]
    assert all(state.stale for state in states)
    with pytest.raises(HoldingError, match=r"joint 6 \(node 16\) is silent for 2 cycles\)"):
        robot.send(PositionCommand(position=START))


def test_a_hold_after_a_stall_says_so(bus, robot):
    bus.time += 6 * PERIOD  # the application did something else
    bus.losing = 2
    states = [robot.receive() for _ in range(2)]
    assert states[-1].stale
    with pytest.raises(HoldingError, match=r"silent .*program itself came 0\.0\d+ s late.*--fifo"):
        robot.send(PositionCommand(position=START))


def test_set_points_never_follow_each_other_faster_than_a_joint_may_move(bus, robot):
    bus.syncs.clear()
    for late in np.linspace(0.0, 3.0, 40):
        bus.time += late * PERIOD
        for _ in range(2):  # late, then prompt
            state = robot.receive()
            robot.send(PositionCommand(position=state.position))
    assert np.diff(bus.syncs).min() >= PERIOD / VELOCITY_TOLERANCE - 1e-9


def test_cycles_that_did_not_take_place_are_counted(bus, robot):
    before, began = robot.overruns, bus.syncs[-1]
    for _ in range(10):
        bus.time += 1.5 * PERIOD
        robot.receive()
    took_place = 10
    time = (bus.syncs[-1] - began) / PERIOD
    assert robot.overruns - before == pytest.approx(time - took_place, abs=1.5)
