"""The driver on drives that are local nodes of the canopen package."""

from dataclasses import replace
from functools import partial

import can
import numpy as np
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot, DriveError
from limo_driver.errors import BackendError, HoldingError
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand


@pytest.fixture
def config():
    return arm_config()


@pytest.fixture
def bus():
    """Return a bus whose time passes only where the driver waits."""
    return SyncBus()


@pytest.fixture
def opened(bus):
    """Return what opens an arm on it."""
    return partial(CanRobot, bus=bus, clock=bus.now)


@pytest.fixture
def arm(bus, config):
    with CanopenArm(bus, NODES, counts_at(config, START)) as drives:
        yield drives


def follow(robot, targets):
    states = [robot.receive()]
    for target in targets:
        robot.send(PositionCommand(position=target))
        states.append(robot.receive())
    return states


@pytest.mark.usefixtures("arm")
def test_measures_position_torque_temperature_and_status(config, opened):
    with opened(config) as robot:
        states = [robot.receive() for _ in range(15)]
        assert np.abs(states[-1].position - START).max() < 2e-5
        assert [s.sequence for s in states] == sorted({s.sequence for s in states})
        assert all(drive.enabled for drive in robot.drives)
        assert robot.drives[2].temperature == pytest.approx(30.5)
        assert robot.drives[2].status == "operation enabled"
        assert robot.drives[2].mode == "position"
        assert states[-1].temperature[2] == pytest.approx(30.5)
        assert states[-1].drives == ("operation enabled",) * 7
        assert robot.spec.torque_resolution == pytest.approx([0.1] * 7)


def test_follows_positions_and_ends_disabled(config, arm, opened):
    targets = START + 0.01 * (1 - np.cos(np.linspace(0, np.pi, 40)))[:, None]
    with opened(config) as robot:
        states = follow(robot, targets)
        last = robot.receive()
        assert np.abs(last.position - targets[-1]).max() < 2e-5
        assert not last.holding
        assert np.abs(states[20].velocity).max() > 0.01
    assert all(drive.state == 0x40 for drive in arm.drives)
    assert all(drive.node.nmt.state == "PRE-OPERATIONAL" for drive in arm.drives)


def test_no_drive_moves_when_it_is_enabled(config, arm, opened):
    before = [drive.count for drive in arm.drives]
    with opened(config) as robot:
        for _ in range(5):
            robot.receive()
    assert [drive.count for drive in arm.drives] == before


def test_configures_watchdogs_and_reactions(config, arm, opened):
    with opened(config):
        store = arm.drives[3].node.sdo
        assert store[0x1016][1].raw == 127 << 16 | 1000
        assert store[0x1017].raw == 250
        assert store[0x1400][5].raw == 1000
        assert store[0x6007].raw == 3
        assert store[0x605A].raw == 6
        assert store[0x1006].raw == 10_000
        assert (store[0x60C2][1].raw, store[0x60C2][2].raw) == (1, -2)
    assert store[0x1016][1].raw == 0


def test_torques_go_out_with_gravity_and_stop_at_rest(config, arm, opened):
    gravity = config.model.gravity_torque(START)[0]
    with opened(config) as robot:
        robot.receive()
        for _ in range(10):
            robot.send(TorqueCommand(torque=np.zeros(7)))
            state = robot.receive()
        assert state.torque == pytest.approx(gravity, abs=0.06)
        assert {drive.mode for drive in arm.drives} == {10}
        robot.hold()
        for _ in range(5):
            robot.receive()
        assert {drive.mode for drive in arm.drives} == {8}


@pytest.mark.usefixtures("arm")
def test_impedance_is_refused(config, opened):
    with opened(config) as robot:
        state = robot.receive()
        zero = np.zeros(7)
        with pytest.raises(BackendError, match="given ImpedanceCommand"):
            robot.send(
                ImpedanceCommand(position=state.position, stiffness=zero, damping=zero, torque=zero)
            )


def test_fault_leads_to_hold_and_is_reset_only_when_told(config, arm, opened):
    with opened(config) as robot:
        follow(robot, [START] * 3)
        arm.drives[2].trip(0x4310)
        states = [robot.receive() for _ in range(5)]
        assert states[-1].holding
        with pytest.raises(HoldingError, match=r"joint 3 \(node 13\).*motor too hot"):
            robot.send(PositionCommand(position=START))
        with pytest.raises(BackendError, match="reset_faults"):
            robot.resume()
        assert arm.drives[2].state == 0x08
        robot.reset_faults()
        assert robot.receive().holding
        robot.resume()
        state = follow(robot, [START] * 3)[-1]
        assert not state.holding


def test_fault_at_the_start_is_named(config, arm, opened):
    arm.drives[4].trip(0x8611)
    with pytest.raises(DriveError, match=r"joint 5 \(node 15\) is in fault: following error"):
        opened(config)
    with opened(config, reset_faults=True) as robot:
        robot.receive()
        assert all(drive.enabled for drive in robot.drives)


def test_silent_joint_is_stale_within_two_cycles_and_holds(config, arm, opened):
    with opened(replace(config, hold_after=2)) as robot:
        follow(robot, [START] * 3)
        arm.drives[5].mute = True
        states = [robot.receive() for _ in range(3)]
        assert any(state.stale for state in states[:2])
        assert states[-1].holding
        assert robot.drives[5].stale
        assert [told.partition(" ")[0] for told in states[-1].drives].index("silent") == 5
        with pytest.raises(HoldingError, match=r"joint 6 \(node 16\) is silent"):
            robot.send(PositionCommand(position=START))


def test_missing_drive_is_named_with_those_that_answer(bus, config, opened):
    nodes = [*NODES[:3], 24, *NODES[4:]]
    fast = replace(config, answer_timeout=0.1)
    with (
        CanopenArm(bus, nodes),
        pytest.raises(DriveError, match=r"joint 4 \(node 14\) does not answer.*node id 24\?"),
    ):
        opened(fast)


def test_swapped_drives_are_named(bus, config, opened):
    joints = tuple(replace(joint, serial=joint.node) for joint in config.joints)
    serials = [11, 12, 14, 13, 15, 16, 17]
    with (
        CanopenArm(bus, NODES, serials=serials),
        pytest.raises(
            DriveError, match=r"joint 3 .*serial number 14, expected 13.*joint 4: swapped"
        ),
    ):
        opened(replace(config, joints=joints))


@pytest.mark.usefixtures("arm")
def test_another_rating_is_another_drive(config, opened):
    joints = (*config.joints[:6], replace(config.joints[6], rated_torque=40.0))
    with pytest.raises(DriveError, match=r"joint 7 .*rated 100000 mN m .*expected 40000"):
        opened(replace(config, joints=joints))


def test_drive_that_cannot_stop_by_itself_is_refused(config, arm, opened):
    arm.drives[1].node.object_dictionary[0x6007].access_type = "ro"
    with pytest.raises(DriveError, match=r"joint 2 .*would go on moving.*6007"):
        opened(config)


@pytest.mark.usefixtures("arm")
def test_own_frames_are_no_answers(config, bus):
    bus.echo = True
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        state = robot.receive()
        assert state.position == pytest.approx(START, abs=2e-5)


def test_nobody_but_oneself_on_the_bus_is_nobody(config, bus):
    bus.echo = True
    with pytest.raises(BackendError, match=r"no drive answers on virtual .*powered, terminated"):
        CanRobot(config, bus=bus, clock=bus.now)


def test_a_drive_that_never_measured_has_no_position(config, bus, arm):
    arm.drives[4].mute = True
    with pytest.raises(DriveError, match=r"joint 5 \(node 15\) answers SDO, but sends no measure"):
        CanRobot(config, bus=bus, clock=bus.now)


@pytest.mark.usefixtures("arm")
def test_what_was_not_heard_is_not_a_number(bus, config):
    unheated = replace(config, temperature=None)
    with CanRobot(unheated, bus=bus, clock=bus.now) as robot:
        drives = robot.drives  # no slow status came so far
        assert all(drive.velocity != drive.velocity for drive in drives)
        assert all(drive.temperature != drive.temperature for drive in drives)
        assert [drive.position for drive in drives] == pytest.approx(START, abs=2e-5)


@pytest.mark.usefixtures("arm")
@pytest.mark.parametrize("fd", [False, True])
def test_fd_frames_switch_the_bitrate(config, bus, fd):
    with CanRobot(replace(config, bus=replace(config.bus, fd=fd)), bus=bus, clock=bus.now) as robot:
        robot.receive()
    kinds = {(message.is_fd, message.bitrate_switch) for message in bus.messages}
    assert kinds == {(fd, fd)}
    assert not any(message.is_extended_id for message in bus.messages)


def test_drive_that_was_left_enabled_does_not_move(config, bus, arm):
    before = [drive.count for drive in arm.drives]
    for drive, count in zip(arm.drives, before, strict=True):
        drive.state, drive.word, drive.target = 0x27, 0x0F, count
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        for _ in range(3):
            robot.receive()
    assert [drive.count for drive in arm.drives] == before


@pytest.mark.usefixtures("arm")
@pytest.mark.parametrize("frame", [(0x080, b""), (0x203 + 8, b"\x00" * 8), (0x77F, b"\x05")])
def test_two_programs_do_not_command_one_arm(config, bus, frame):
    bus.deliver(*frame)
    with pytest.raises(BackendError, match=f"another program.*{frame[0]:03X}"):
        CanRobot(config, bus=bus, clock=bus.now)


@pytest.mark.usefixtures("arm")
def test_a_position_out_of_reach_is_not_believed(config, bus):
    with CanRobot(replace(config, hold_after=2), bus=bus, clock=bus.now) as robot:
        state = robot.receive()
        robot.send(PositionCommand(position=state.position))
        for _ in range(3):
            bus.losing = 1
            bus.deliver(0x180 + NODES[2], b"\x27\x06\xff\xff\xff\x3f\x00\x00")
            state = robot.receive()
            assert state.position == pytest.approx(START, abs=2e-5)
        assert state.holding


@pytest.mark.usefixtures("arm")
def test_a_bus_that_is_off_leads_to_hold(config, bus):
    with CanRobot(config, bus=bus, clock=bus.now) as robot:
        state = robot.receive()
        robot.send(PositionCommand(position=state.position))
        bus.queue.append(can.Message(arbitration_id=0x40, is_error_frame=True))
        assert robot.receive().holding


def test_a_restarted_drive_is_named_and_started_again_when_told(config, bus, arm):
    with CanRobot(replace(config, hold_after=2), bus=bus, clock=bus.now) as robot:
        state = robot.receive()
        robot.send(PositionCommand(position=state.position))
        drive = arm.drives[1]
        drive.node.nmt.state = "INITIALISING"
        drive.node.nmt.state = "PRE-OPERATIONAL"
        drive.state, drive.word = 0x40, 0
        states = [robot.receive() for _ in range(3)]
        assert states[-1].holding
        with pytest.raises(BackendError, match=r"joint 2 \(node 12\) restarted"):
            robot.resume()
        robot.reset_faults()
        robot.resume()
        state = robot.receive()
        robot.send(PositionCommand(position=state.position))
        assert not robot.receive().holding
