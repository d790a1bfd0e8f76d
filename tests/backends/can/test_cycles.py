"""Watchdogs both ways, velocities, late answers, and the end of a session, cycle by cycle."""

from dataclasses import replace

import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot
from backends.can.cia402.codec import MEASURED
from limo_driver.errors import BackendError, ConfigError, HoldingError
from limo_driver.types import PositionCommand, TorqueCommand


@pytest.fixture
def bus():
    return SyncBus()


@pytest.fixture
def config():
    return arm_config(hold_after=2)


@pytest.fixture
def arm(bus, config):
    with CanopenArm(bus, NODES, counts_at(config, START)) as drives:
        yield drives


def run(robot, cycles, speed=0.0):
    """Move all joints at a speed [rad/s], slowly begun."""
    state = robot.receive()
    q, v = np.array(state.position), 0.0
    for _ in range(cycles):
        v = min(v + 2.0 * robot.spec.period, speed)
        q = q + v * robot.spec.period
        robot.send(PositionCommand(position=q))
        state = robot.receive()
    return state


@pytest.mark.usefixtures("arm")
def test_heartbeat_tells_that_the_loop_runs(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        assert not [data for frame_id, data in bus.sent if frame_id == 0x77F]
        robot.receive()
        bus.sent.clear()
        run(robot, 100)  # 1 s, with a watchdog of 1 s
        beats = [data for frame_id, data in bus.sent if frame_id == 0x77F]
    assert len(beats) in {4, 5}
    assert set(beats) == {b"\x05"}


@pytest.mark.usefixtures("arm")
def test_lost_heartbeat_leads_to_hold(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 5)
        bus.deliver(0x700 + NODES[3], b"\x05")
        assert not run(robot, 80).holding
        with pytest.raises(HoldingError, match=r"joint 4 \(node 14\) lost its heartbeat"):
            run(robot, 40)


@pytest.mark.usefixtures("arm")
def test_velocity_is_that_of_the_positions(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        assert run(robot, 60, speed=0.2).velocity == pytest.approx([0.2] * 7, abs=2e-3)


@pytest.mark.usefixtures("arm")
def test_velocity_is_that_of_the_drives_where_they_send_it_each_cycle(bus, config):
    every = replace(config, status_every=1)
    with CanRobot(every, bus=bus, clock=bus.now) as robot:
        # The drives of this test count in counts a cycle, not a second.
        expected = 0.2 * robot.spec.period
        assert run(robot, 60, speed=0.2).velocity == pytest.approx([expected] * 7, abs=2e-5)


@pytest.mark.usefixtures("arm")
def test_one_lost_answer_is_stale_and_no_reason_to_hold(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        before = run(robot, 5)
        bus.losing = 1
        lost = robot.receive()
        after = robot.receive()
    assert (lost.stale, lost.holding, lost.sequence) == (True, False, before.sequence)
    assert (after.stale, after.holding, after.sequence) == (False, False, before.sequence + 2)


def test_late_answer_is_waited_for(bus, config, arm):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        before = run(robot, 5)
        arm.drives[2].mute = True
        data = MEASURED.pack(0x27, arm.drives[2].count, 0)
        bus.later.append((bus.now() + 2.5 * robot.spec.period, 0x180 + NODES[2], data))
        state = robot.receive()
    assert (state.stale, state.sequence) == (False, before.sequence + 1)


def test_drives_are_switched_off_one_by_one_from_the_wrist(bus, config, arm):
    order = []
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 40, speed=0.3)
        moving = [drive.count for drive in arm.drives]

        def watch():
            order.extend(
                drive.node.id
                for drive in arm.drives
                if drive.state != 0x27 and drive.node.id not in order
            )

        bus.noise = watch
    assert order == sorted(NODES, reverse=True)
    stopped = [drive.count for drive in arm.drives]
    assert stopped != moving  # it braked, and did not stop dead
    assert bus.sent[-1][0] in {0x000, *(0x600 + node for node in NODES)}


@pytest.mark.usefixtures("arm")
def test_rate_that_cannot_be_is_refused_before_anything_is_sent(bus, config):
    with pytest.raises(ConfigError, match="does not fit"):
        CanRobot(replace(config, rate=600.0), bus=bus, clock=bus.now)
    assert not bus.sent


@pytest.mark.usefixtures("arm")
def test_no_torques_where_the_bus_is_too_slow_for_them(bus, config):
    with CanRobot(replace(config, rate=420.0), bus=bus, clock=bus.now) as robot:
        robot.receive()
        with pytest.raises(BackendError, match=r"no torques at this rate.*RPDO2"):
            robot.send(TorqueCommand(torque=np.zeros(7)))


@pytest.mark.usefixtures("arm")
def test_a_long_pause_before_the_first_cycle_is_caught_up_with(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        for _ in range(1000):
            for node in NODES:
                bus.deliver(0x700 + node, b"\x05")
        states = [robot.receive() for _ in range(3)]
    assert not any(state.stale or state.holding for state in states)


def test_a_stream_starts_without_a_step_of_the_drives(bus, config, arm):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 5)
        robot.hold()
        robot.receive()
        held = arm.drives[0].target
        for drive in arm.drives:
            drive.lag = 400  # counts behind its target: something leans on the arm
        for _ in range(3):
            state = robot.receive()
        robot.resume()
        targets = []
        for _ in range(200):
            robot.send(PositionCommand(position=state.position))
            robot.receive()
            targets.append(arm.drives[0].target)
    slower = config.model.limits.acceleration[0] * config.joints[0].counts_per_radian / 100.0**2
    path = np.array([held, held, *targets])
    assert np.abs(np.diff(path, n=2)).max() <= slower + 2  # it gives way within the limits
    assert abs(targets[-1] - (held - 400)) <= 2


def is_sync(bus):
    return bus.sent[-1][0] == 0x080


def test_reset_at_speed_brakes_first(bus, config, arm):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 40, speed=0.3)
        targets = []
        bus.noise = lambda: targets.append(arm.drives[0].target) if is_sync(bus) else None
        robot.receive()
        arm.drives[2].trip(0x4310)
        robot.receive()
        robot.reset_faults()
    speed = np.diff(targets)
    slower = config.model.limits.acceleration[0] * config.joints[0].counts_per_radian / 100.0**2
    assert speed[0] > 0
    assert speed[-1] == 0
    assert np.abs(np.diff(speed)).max() <= slower + 2


def test_a_drive_that_started_again_by_itself_gets_its_watchdogs_back(bus, config, arm):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 5)
        drive = arm.drives[1]
        drive.node.nmt.state = "INITIALISING"
        for index in (0x1400, 0x1016):
            drive.node.sdo[index][5 if index == 0x1400 else 1].raw = 0
        drive.node.nmt.state = "OPERATIONAL"
        drive.state, drive.word = 0x40, 0
        for _ in range(3):
            state = robot.receive()
        assert state.holding
        robot.reset_faults()
        assert drive.node.sdo[0x1400][5].raw == 1000
        assert drive.node.sdo[0x1016][1].raw == 127 << 16 | 1000
        robot.resume()
        assert not run(robot, 5).holding


def test_what_lies_between_stream_and_drive_leads_no_joint_out_of_its_range(bus, config):
    end = config.model.limits.position_max[0]
    start = np.array([end - 0.05, *START[1:]])
    most = round((end - config.joints[0].offset) * config.joints[0].counts_per_radian)
    with (
        CanopenArm(bus, NODES, counts_at(config, start)) as arm,
        CanRobot(config, bus=bus, clock=bus.now) as robot,
    ):
        run(robot, 5)
        robot.hold()
        robot.receive()
        arm.drives[0].lag = 3000  # counts behind its target: something leans on the joint
        for _ in range(3):
            state = robot.receive()
        robot.resume()
        targets = []
        for k in range(60):
            toward = np.array([0.002 * k, *np.zeros(6)])
            robot.send(PositionCommand(position=state.position + toward))
            robot.receive()
            targets.append(arm.drives[0].target)
    assert max(targets) == pytest.approx(most, abs=1)


@pytest.mark.usefixtures("arm")
def test_no_torque_goes_on_while_drives_are_switched_off(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        robot.receive()
        for _ in range(10):
            robot.send(TorqueCommand(torque=np.zeros(7)))
            robot.receive()
        bus.sent.clear()
    wrist = [frame_id == 0x200 + NODES[-1] and data[0] == 0x06 for frame_id, data in bus.sent]
    modes = {
        data[2] for frame_id, data in bus.sent[wrist.index(True) :] if frame_id - 0x300 in NODES
    }
    assert modes <= {8}


@pytest.mark.usefixtures("arm")
def test_unused_pdos_are_switched_off(bus, config, arm):
    record = arm.drives[0].node.sdo[0x1802]
    record[1].raw = 0x380 + NODES[0]  # as it was delivered
    with CanRobot(replace(config, temperature=None), bus=bus, clock=bus.now):
        assert record[1].raw == 0x8000_0000 | 0x380 + NODES[0]


@pytest.mark.usefixtures("arm")
def test_a_joint_that_was_silent_is_waited_for_before_commands_are_taken_again(bus, config):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        run(robot, 5)
        bus.losing = 4
        states = [robot.receive() for _ in range(2)]
        assert states[-1].holding
        with pytest.raises(BackendError, match="silent for 2 cycles; call reset_faults"):
            robot.resume()
        robot.reset_faults()
        robot.resume()
        assert not run(robot, 5).holding
        bus.losing = 10_000
        robot.receive()
        with pytest.raises(BackendError, match=r"joint 1 \(node 11\) does not answer SYNC"):
            robot.reset_faults()
