"""The FRI driver: what it answers in each state, what it counts, and how it opens."""

import os
import signal
import socket
import threading
import time

import numpy as np
import pytest
from fri_messages import POSE
from ports import free_port
from stepped_arm import SteppedArm, stepped, wake

from backends.fri import FriRobot
from backends.fri.codec import messages as m
from backends.fri.codec.messages import (
    CommandMode,
    DriveState,
    Generation,
    IoDirection,
    IoType,
    IoValue,
    Quality,
    SessionState,
)
from limo_driver.errors import (
    BackendError,
    ConfigError,
    ConnectionLostError,
    HoldingError,
    JointLimitError,
    ShapeError,
)
from limo_driver.types import (
    ImpedanceCommand,
    PositionCommand,
    TorqueCommand,
    WrenchCommand,
)

pytestmark = pytest.mark.waits

ACTIVE = SessionState.COMMANDING_ACTIVE
ASIDE = np.array(POSE) + 0.01  # where the arm is, against where its application has it


def one_answer(robot):
    """Let a cycle pass that the user does not answer; return what the driver said to it."""
    robot.receive()
    robot.receive()
    taken = robot.arm.listen()
    return taken[-1] if taken else robot.arm.answers[-1] if robot.arm.answers else None


def without(arm, **data):
    """Let the arm's messages have other data from now on."""

    def message():
        plain = SteppedArm.message(arm)
        return plain._replace(data=plain.data._replace(**data))

    arm.message = message


def test_idle_robot_gets_no_answer():
    with stepped(state=SessionState.IDLE) as robot:
        assert one_answer(robot) is None
        assert robot.session_state is SessionState.IDLE
        assert robot.receive().position == pytest.approx(POSE)


@pytest.mark.parametrize("state", [SessionState.MONITORING_WAIT, SessionState.MONITORING_READY])
def test_monitored_robot_gets_its_position_back(state):
    with stepped(state=state) as robot:
        assert one_answer(robot).data.joint_position == POSE
    with stepped(state=state, generation=Generation.TWO_FIVE) as robot:
        assert one_answer(robot).data is None


@pytest.mark.parametrize("generation", list(Generation))
@pytest.mark.parametrize("mode", [CommandMode.POSITION, CommandMode.TORQUE, CommandMode.WRENCH])
def test_waiting_robot_gets_the_position_of_its_application(mode, generation):
    with stepped(state=SessionState.COMMANDING_WAIT, mode=mode, generation=generation) as robot:
        robot.arm.position = ASIDE
        data = one_answer(robot).data
    assert data.joint_position == POSE
    assert data.joint_torque == ((0.0,) * 7 if mode is CommandMode.TORQUE else None)
    assert data.wrench == ((0.0,) * 6 if mode is CommandMode.WRENCH else None)


def test_waiting_robot_that_names_no_position_gets_no_answer():
    with stepped(state=SessionState.COMMANDING_WAIT) as robot:
        robot.arm.message = lambda arm=robot.arm, **_: SteppedArm.message(arm)._replace(ipo=None)
        assert one_answer(robot) is None


def test_counters_start_at_zero_and_reflect():
    with stepped(first_sequence=7, state=SessionState.MONITORING_READY) as robot:
        for _ in range(5):
            robot.receive()
        robot.arm.listen()
    headers = [command.header for command in robot.arm.answers]
    assert [header.sequence for header in headers] == [0, 1, 2, 3, 4]
    assert [header.reflected for header in headers] == [7, 8, 9, 10, 11]


def test_every_third_packet_is_answered_where_the_robot_asks_for_that():
    with stepped(multiplier=3, period_ms=2, state=SessionState.MONITORING_READY) as robot:
        assert robot.spec.period == pytest.approx(6e-3)
        states = [robot.receive() for _ in range(3)]
        robot.arm.listen()
    assert [c.header.reflected for c in robot.arm.answers] == [2, 5, 8]
    assert np.diff([state.time for state in states]) == pytest.approx([6e-3] * 2)
    assert [state.sequence for state in states] == [0, 1, 2]


def test_multiplier_of_zero_means_every_packet():
    with stepped(multiplier=1) as robot:
        arm = robot.arm
        arm.message = lambda: SteppedArm.message(arm)._replace(
            connection=SteppedArm.message(arm).connection._replace(receive_multiplier=0),
        )
        assert [robot.receive().stale for _ in range(3)] == [False] * 3


def test_sequence_counters_may_wrap():
    with stepped(first_sequence=2**32 - 3) as robot:
        states = [robot.receive() for _ in range(8)]
        robot.arm.listen()
    assert [state.sequence for state in states] == list(range(8))
    assert robot.arm.answers[-1].header.reflected == 3
    assert robot.figures.lost == 0


def test_loss_lateness_and_order_are_counted():
    with stepped() as robot:
        arm = robot.arm
        robot.receive()
        arm.sequence += 2  # two packets are lost
        robot.receive()
        assert robot.figures.lost == 2
        old = arm.message()
        robot.receive()
        arm.send(old)
        robot.receive()
        assert robot.figures.old == 1
        arm.deaf = 1
        for _ in range(3):
            robot.receive()
        assert robot.figures.unreceived == 1
        assert robot.figures.answered == 6


def test_late_answer_is_counted_as_late():
    with stepped() as robot:
        arm = robot.arm
        for _ in range(3):
            robot.receive()
        assert arm.reflected == 1
        plain = SteppedArm.message
        arm.message = lambda: plain(arm)._replace(header=m.Header(arm.sequence, 1))
        robot.receive()  # answer 2 has come too late for this packet
        del arm.message
        arm.listen()
        arm.reflected, arm.listen = 2, list
        robot.receive()
        assert (robot.figures.late, robot.figures.unreceived) == (1, 0)


def test_version_is_told_or_checked():
    with stepped(generation=Generation.TWO_SEVEN) as robot:
        assert robot.generation is Generation.TWO_SEVEN
    with stepped(version="1.11") as robot:
        assert robot.generation is Generation.ONE
    with pytest.raises(BackendError, match=r"speaks FRI 2\.5, but 1\.15 was asked for"):
        stepped(generation=Generation.TWO_FIVE, version="1.15")
    with pytest.raises(ConfigError, match=r"1\.14, 1\.15"):
        FriRobot(version="1.13")


def test_time_is_the_robots_and_monotonic():
    with stepped(period_ms=5) as robot:
        arm = robot.arm
        times = [robot.receive().time for _ in range(3)]
        arm.ns += 20_000_000  # four packets came late by the robot's own clock
        times.append(robot.receive().time)
        arm.ns -= 3_600_000_000_000  # somebody set the clock
        arm.sequence += 1
        times += [robot.receive().time for _ in range(2)]
    assert np.diff(times[:3]) == pytest.approx([5e-3] * 2)
    assert times[3] - times[2] == pytest.approx(25e-3)
    assert (np.diff(times) > 0).all()
    assert robot.figures.clock_steps == 1


def test_velocity_is_that_of_the_positions():
    with stepped() as robot:
        start = robot.receive()
        for k in range(1, 200):
            robot.send(PositionCommand(position=start.position + 2e-4 * min(k, 100)))
            state = robot.receive()
            if k == 100:
                assert state.velocity == pytest.approx([0.2] * 7, rel=0.01)
    assert np.abs(state.velocity).max() < 1e-3


def test_torque_session_adds_torque_to_the_mirrored_position():
    torque = np.array([0.05, 0.1, 0, 0, 0, 0, 0.02])
    with stepped(mode=CommandMode.TORQUE) as robot:
        robot.receive()
        for _ in range(5):
            robot.send(TorqueCommand(torque=torque))
            robot.receive()
        robot.arm.listen()
        data = robot.arm.answers[-1].data
    assert data.joint_torque == pytest.approx(tuple(torque))
    assert data.joint_position == POSE
    assert data.wrench is None


def test_wrench_session_sends_wrenches_within_limits_and_rates():
    with stepped(mode=CommandMode.WRENCH) as robot:
        robot.receive()
        sent = []
        for _ in range(300):
            sent.append(robot.send(WrenchCommand(wrench=np.array([1000.0, 0, 0, 0, 0, -1000.0]))))
            robot.receive()
        robot.hold()
        for _ in range(300):
            robot.receive()
        robot.arm.listen()
    wrenches = np.array([c.data.wrench for c in robot.arm.answers])
    assert wrenches.max(axis=0)[0] == 50.0
    assert wrenches.min(axis=0)[5] == -10.0
    assert np.abs(np.diff(wrenches, axis=0)).max(axis=0) == pytest.approx([0.5, 0, 0, 0, 0, 0.1])
    assert set(sent[0].limited_by) == {"wrench", "wrench_rate"}
    assert not wrenches[-1].any()
    assert {c.data.joint_position for c in robot.arm.answers} == {POSE}


def test_wrench_has_six_finite_components():
    with stepped(mode=CommandMode.WRENCH) as robot:
        robot.receive()
        with pytest.raises(ShapeError, match=r"wrench has shape \(7,\), expected \(6,\)"):
            robot.send(WrenchCommand(wrench=np.zeros(7)))
        with pytest.raises(JointLimitError, match="wrench"):
            robot.send(WrenchCommand(wrench=np.array([0, 0, np.nan, 0, 0, 0])))


@pytest.mark.parametrize("mode", [CommandMode.POSITION, CommandMode.TORQUE, CommandMode.WRENCH])
def test_command_of_another_kind_is_refused(mode):
    zero = np.zeros(7)
    commands = {
        CommandMode.POSITION: PositionCommand(position=np.array(POSE)),
        CommandMode.TORQUE: TorqueCommand(torque=zero),
        CommandMode.WRENCH: WrenchCommand(wrench=np.zeros(6)),
        None: ImpedanceCommand(position=np.array(POSE), stiffness=zero, damping=zero, torque=zero),
    }
    with stepped(mode=mode) as robot:
        robot.receive()
        for kind, command in commands.items():
            if kind is mode:
                robot.send(command)
            else:
                with pytest.raises(BackendError, match=rf"command mode {mode.name}\), not"):
                    robot.send(command)


def test_outputs_are_set_until_received_and_inputs_read():
    io = (
        IoValue("Tool.Grip", IoType.BOOLEAN, IoDirection.OUTPUT, 0),
        IoValue("Tool.Force", IoType.ANALOG, IoDirection.INPUT, analog=2.5),
        IoValue("Tool.Volt", IoType.ANALOG, IoDirection.OUTPUT, analog=0.0),
        IoValue("Tool.Code", IoType.DIGITAL, IoDirection.OUTPUT, 0),
    )
    with stepped() as robot:
        arm = robot.arm
        arm.io = io
        robot.receive()
        said = {"Tool.Grip": False, "Tool.Force": 2.5, "Tool.Volt": 0.0, "Tool.Code": 0}
        assert robot.ios == said
        robot.set_output("Tool.Grip", True)
        arm.deaf = 1  # the first answer with it is lost
        for _ in range(5):
            robot.receive()
        arm.listen()
        for name, value, said in (
            ("Tool.Nope", 1, "names: Tool.Grip, Tool.Force, "),
            ("Tool.Force", 1.0, "is an input"),
            ("Tool.Grip", 2, "is a boolean"),
            ("Tool.Volt", float("nan"), "is analog, but nan"),
            ("Tool.Volt", "1", "is analog, but '1'"),
            ("Tool.Code", float("inf"), "is an integer of 64 bits, but inf"),
            ("Tool.Code", 2**64, "is an integer of 64 bits"),
            ("Tool.Code", 10**400, "is an integer of 64 bits"),
            ("Tool.Code", 1.5, "is an integer of 64 bits, but 1.5"),
        ):
            with pytest.raises(ConfigError, match=said):
                robot.set_output(name, value)
    told = [[(o.name, o.value) for o in c.data.io] for c in arm.answers]
    assert told[0] == [("Tool.Grip", True)]
    assert told[-1] == []


def test_own_signals_of_the_robot_are_there():
    with stepped() as robot:
        with pytest.raises(BackendError, match="receive"):
            _ = robot.external_torque
        robot.receive()
        assert robot.external_torque == pytest.approx([0.5] * 7)
        assert robot.commanded_torque == pytest.approx([2.0] * 7)
        assert robot.quality is Quality.EXCELLENT
        assert [visit.state for visit in robot.visits] == [ACTIVE]
        without(robot.arm, external_torque=None)
        robot.receive()
        with pytest.raises(BackendError, match="does not send its external torque"):
            _ = robot.external_torque


def test_waiting_for_commanding_answers_meanwhile_and_says_what_is_missing():
    with stepped(state=SessionState.MONITORING_READY) as robot:
        with pytest.raises(BackendError, match=r"still in MONITORING_READY after 0.02 s.*overlay"):
            robot.wait_until_ready(timeout=0.02)
        assert robot.arm.answers
        robot.arm.state = ACTIVE
        robot.wait_until_ready()
        robot.send(PositionCommand(position=np.array(POSE)))


def test_a_robot_that_pauses_after_its_first_packet_is_waited_for():
    with stepped() as robot:
        robot.arm.losing = 3
        robot.wait_until_ready()
        assert robot.figures.stale == 3
    with stepped() as robot:
        robot.arm.losing = 10**9
        with pytest.raises(BackendError, match=r"nothing usable any more when 0\.02 s were over"):
            robot.wait_until_ready(timeout=0.02)


def test_each_packet_is_answered_once_however_often_one_sends():
    with stepped() as robot:
        robot.receive()
        for aside in (0.0, 0.001, -0.001):
            robot.send(PositionCommand(position=np.array(POSE) + aside))
        assert [command.header.reflected for command in robot.arm.listen()] == [0]
        for _ in range(100):
            robot.receive()
        robot.arm.listen()
        assert robot.arm.answers[-1].data.joint_position == pytest.approx(np.array(POSE) - 0.001)


def test_cartesian_pose_that_is_not_finite_is_not_mirrored():
    pose = m.Transformation("tip", (0.1, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    with stepped(state=SessionState.COMMANDING_WAIT, generation=Generation.TWO_FIVE) as robot:
        arm = robot.arm
        plain = SteppedArm.message
        for elements in (pose.elements, (*pose.elements[:6], float("nan"))):
            ipo = m.IpoData(
                pose=pose._replace(elements=elements), command_mode=CommandMode.CARTESIAN_POSE
            )
            arm.message = lambda ipo=ipo: plain(arm)._replace(ipo=ipo)
            robot.receive()
            mirrored = [command.data.pose for command in arm.listen()]
            assert mirrored == ([pose] if elements == pose.elements else [])


def test_session_of_another_pace_is_another_session():
    with stepped(state=SessionState.MONITORING_READY) as robot:
        robot.receive()
        robot.arm.period_ms = 4
        with pytest.raises(ConnectionLostError, match=r"send period of 4 ms.*began with 1 ms"):
            robot.receive()


def test_a_signal_ends_a_long_wait_for_a_robot_that_fell_silent(monkeypatch, request):
    usual = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, usual))
    with stepped() as robot:
        robot.receive()
        robot.send(PositionCommand(position=np.array(POSE)))
        robot.receive()
        monkeypatch.setattr(robot.arm, "cycle", lambda: None)
        pressed = threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT))
        pressed.start()
        began = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            robot.receive(timeout=600.0)
        pressed.join()
        assert time.monotonic() < began + 60.0
        monkeypatch.undo()


def test_nobody_there_is_said_in_time():
    port = free_port()
    with pytest.raises(ConnectionLostError, match=rf"nobody sent to UDP port {port} within 0.05 s"):
        FriRobot(port=port, connect_timeout=0.05)


def test_stranger_instead_of_the_robot_is_named():
    port = free_port()
    arm = SteppedArm(port=port, host="127.0.0.3")
    arm.host = "127.0.0.9"  # where the driver expects it
    with pytest.raises(ConnectionLostError, match=r"127\.0\.0\.9.*datagrams from 127\.0\.0\.3"):
        wake(arm, connect_timeout=0.5)
    arm.close()


def test_garbage_instead_of_the_robot_is_described():
    arm = SteppedArm()
    arm.send = lambda: arm.throw(b"hello")
    with pytest.raises(ConnectionLostError, match=r"none could be used: neither a bare nor"):
        wake(arm, connect_timeout=0.5)
    arm.close()


def test_taken_port_is_said():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 0))  # noqa: S104
        port = other.getsockname()[1]
        with pytest.raises(BackendError, match=f"UDP port {port} is taken by another program"):
            FriRobot(port=port)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"host": "x" * 70}, "has no IPv4 address"),
        ({"port": 70000}, "port 70000 is outside"),
        ({"robot": "nope.urdf"}, "nope.urdf"),
    ],
)
def test_bad_options_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        FriRobot(**options)


def test_arm_of_two_joints_is_refused(two_links_urdf):
    with pytest.raises(ConfigError, match="have 7 joints"):
        FriRobot(robot=str(two_links_urdf))


def test_first_valid_sender_is_the_robot_and_stays_it():
    arm = SteppedArm()
    stranger = SteppedArm(port=arm.port, host="127.0.0.5", position=np.zeros(7))
    arm.host, host = None, arm.host
    with wake(arm) as robot:
        stranger.send()
        arm.host = host
        arm.sequence += 1
        arm.ns += 1_000_000
        arm.send()
        assert robot.receive().position == pytest.approx(POSE)
        assert robot.foreign == 1
    arm.close()
    stranger.close()


def test_stop_of_the_arm_is_the_reason_of_the_hold():
    with stepped() as robot:
        arm = robot.arm
        robot.receive()
        robot.send(PositionCommand(position=np.array(POSE)))
        arm.state = SessionState.MONITORING_READY
        plain = SteppedArm.message
        off = (DriveState.ACTIVE, DriveState.OFF, *[DriveState.ACTIVE] * 5)
        arm.message = lambda: plain(arm)._replace(robot=plain(arm).robot._replace(drive_states=off))
        assert robot.receive().holding
        with pytest.raises(HoldingError, match=r"left COMMANDING_ACTIVE.*drives of joints 2"):
            robot.send(PositionCommand(position=np.array(POSE)))


def test_absent_timestamps_leave_the_send_period():
    with stepped(period_ms=2) as robot:
        without(robot.arm, timestamp=None)
        assert [robot.receive().time for _ in range(3)] == pytest.approx([0, 2e-3, 4e-3])
