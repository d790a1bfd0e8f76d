"""What other stacks for arms on CAN got wrong."""

from dataclasses import replace

import can
import pytest
from arms import NODES, START, arm_config, counts_at
from canopen_drives import CanopenArm
from sync_bus import SyncBus

from backends.can import CanRobot, DriveError
from limo_driver.errors import BackendError
from limo_driver.types import PositionCommand


@pytest.fixture
def bus():
    return SyncBus()


@pytest.fixture
def config():
    return arm_config()


@pytest.fixture
def arm(bus, config):
    with CanopenArm(bus, NODES, counts_at(config, START)) as drives:
        yield drives


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
