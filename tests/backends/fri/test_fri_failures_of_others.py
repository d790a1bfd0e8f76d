"""What goes wrong for users of other FRI stacks, each as a test."""

import time

import numpy as np
import pytest
from fri_messages import POSE, monitoring
from ports import free_port
from stepped_arm import keep_kernel_time, stepped

from backends.fri import FriRobot
from backends.fri.answers import DOUBTED
from backends.fri.codec.codec import detect, encode_monitoring
from backends.fri.codec.messages import CommandMode, Generation, Quality, SessionState
from backends.fri.robot import STALL
from limo_driver.errors import BackendError, ConnectionLostError, HoldingError, WireFormatError
from limo_driver.types import PositionCommand, TorqueCommand

ACTIVE = SessionState.COMMANDING_ACTIVE


def position(values):
    return PositionCommand(position=np.array(values))


def positions_of(arm):
    """All positions that reached the arm, (T, 7)."""
    arm.listen()
    return np.array([command.data.joint_position for command in arm.answers])


def speed_up(robot, cycles=400):
    """Move towards a goal that is far away."""
    state = robot.receive()
    goal = state.position + 0.6
    robot.send(position(state.position))
    for _ in range(cycles):
        robot.receive()
        robot.send(position(goal))
    return goal


def test_torque_commands_are_forwarded():
    with stepped(mode=CommandMode.TORQUE) as robot:
        robot.receive()
        for _ in range(100):
            robot.send(TorqueCommand(torque=np.full(7, 0.5)))
            robot.receive()
        robot.arm.listen()
        moved = np.array(POSE) + 0.5 * 0.5 / 2.0 * 0.1**2
        assert robot.arm.answers[-1].data.joint_torque == pytest.approx((0.5,) * 7)
        assert robot.arm.position == pytest.approx(moved, abs=1e-4)


def test_no_command_is_ever_zero_by_default():
    with stepped(state=SessionState.MONITORING_WAIT) as robot:
        for state in (*SessionState, *reversed(SessionState), *SessionState):
            robot.arm.state = state
            for _ in range(3):
                robot.receive()
        sent = positions_of(robot.arm)
    assert np.abs(sent - np.array(POSE)).max() < 1e-12


@pytest.mark.slow("thousands of cycles at the wire")
def test_reconnecting_under_motion_does_not_jerk():
    with stepped() as robot:
        arm, limits = robot.arm, robot.spec.limits
        for k in range(6):
            speed_up(robot, 60 if k else 400)
            arm.state = SessionState.MONITORING_READY if k % 2 else SessionState.IDLE
            arm.ipo, arm.velocity = arm.position.copy(), np.zeros(7)  # it was stopped here
            for _ in range(5):
                assert robot.receive().holding
            if k % 3 == 0:  # a session of its own, which counts from the start
                arm.sequence = 0
            arm.answers.clear()
            for state in (SessionState.MONITORING_READY, SessionState.COMMANDING_WAIT, ACTIVE):
                if state is SessionState.COMMANDING_WAIT:
                    joins = arm.sequence + 1
                arm.state = state
                for _ in range(5):
                    robot.receive()
            robot.resume()
            robot.receive()
            speed_up(robot, 20)
            # Monitored, a robot ignores answers; they brake one that never left, whatever it says.
            path = positions_of(arm)
            joined = [command.header.reflected for command in arm.answers].index(joins)
            for part, end in ((path[:joined], joined), (path[joined:], 20)):
                steps = np.abs(np.diff(part, axis=0)).max(axis=0)
                assert (steps <= limits.velocity * robot.spec.period * (1 + 1e-5)).all()
                change = np.abs(np.diff(part[-end:], n=2, axis=0)).max(axis=0)
                assert (change <= limits.acceleration * robot.spec.period**2 * (1 + 1e-4)).all()
            assert path[joined] == pytest.approx(arm.ipo)


def test_arm_moved_by_hand_is_commanded_from_where_its_application_has_it():
    aside = np.array(POSE) + 0.3  # pushed away under impedance control
    with stepped(state=SessionState.COMMANDING_WAIT) as robot:
        arm = robot.arm
        arm.obey = lambda: None
        arm.position = aside
        robot.receive()
        arm.state = ACTIVE
        state = robot.receive()
        assert state.position == pytest.approx(aside)
        for _ in range(50):
            robot.send(position(aside))
            robot.receive()
        path = positions_of(arm)
    assert path[0] == pytest.approx(np.array(POSE), abs=1e-4)
    step = robot.spec.limits.velocity * robot.spec.period
    assert (np.abs(np.diff(path, axis=0)) <= step * (1 + 1e-5)).all()


def test_held_arm_is_not_drawn_back_to_its_application():
    with stepped(state=SessionState.COMMANDING_WAIT) as robot:
        arm = robot.arm
        robot.receive()
        arm.state = ACTIVE
        speed_up(robot, 300)
        robot.hold()
        while not robot.standing:
            robot.receive()
        held = robot.setpoint.copy()
        robot.resume()
        for _ in range(50):
            robot.receive()
        assert np.abs(held - arm.ipo).max() > 0.1
        assert robot.setpoint == pytest.approx(held)
        assert positions_of(arm)[-1] == pytest.approx(held)


def test_nothing_sleeps_between_packet_and_answer(monkeypatch):
    def no_sleep(_):
        raise AssertionError("the loop sleeps, and quality would flap")

    with stepped() as robot:
        monkeypatch.setattr(time, "sleep", no_sleep)
        for _ in range(50):
            state = robot.receive()
            robot.send(position(state.position))
            # The answer is on the wire when send returns, not one cycle later.
            assert robot.arm.listen()[-1].header.reflected == robot.arm.sequence


def test_client_does_not_wait_for_ever_for_a_robot_that_is_not_there():
    with pytest.raises(ConnectionLostError, match="limo doctor fri"):
        FriRobot(port=free_port(), connect_timeout=0.02)
    with stepped() as robot:
        robot.receive()
        robot.arm.losing = 10**6
        assert robot.receive().stale
        with pytest.raises(BackendError, match="sent nothing usable any more"):
            robot.wait_until_ready(timeout=0.05)


@pytest.mark.parametrize("generation", list(Generation))
def test_version_is_found_out(generation):
    assert detect(encode_monitoring(monitoring(generation), generation)) is generation
    with stepped(generation=generation) as robot:
        assert robot.generation is generation


def test_unknown_version_is_an_error_not_a_guess():
    with pytest.raises(WireFormatError):
        detect(b"\x12\x04\x08\x01\x10\x02")


@pytest.mark.parametrize("left_for", [s for s in SessionState if s is not ACTIVE])
def test_commanding_is_not_resumed_without_being_told(left_for):
    with stepped() as robot:
        arm = robot.arm
        robot.receive()
        robot.send(position(POSE))
        robot.receive()
        arm.state = left_for
        by_hand = 0.2 if left_for < SessionState.COMMANDING_WAIT else 0.008  # else it is a jump
        moved = np.array(POSE) + by_hand
        arm.position, arm.ipo, arm.velocity = moved, moved.copy(), np.zeros(7)
        for _ in range(round(1e3 * DOUBTED) + 1):  # it waits for an answer, at least
            assert robot.receive().holding
        arm.listen()
        arm.answers.clear()
        arm.state = ACTIVE
        for _ in range(20):
            assert robot.receive().holding
            with pytest.raises(HoldingError, match="left COMMANDING_ACTIVE"):
                robot.send(position(moved + 0.01))
        assert np.abs(positions_of(arm) - moved).max() < 1e-12
        robot.resume()
        assert not robot.receive().holding
        robot.send(position(moved))


def test_session_that_starts_again_unseen_is_not_resumed():
    with stepped(first_sequence=5000) as robot:
        robot.receive()
        robot.send(position(POSE))
        robot.receive()
        robot.arm.sequence = 3  # COMMANDING_ACTIVE before and after, but counted anew
        assert robot.receive().holding
        assert robot.figures.restarts == 1


def test_old_state_is_not_served_as_fresh():
    with stepped() as robot:
        arm = robot.arm
        before = robot.receive()
        robot.lose_measurements(3)
        for _ in range(3):
            state = robot.receive()
            assert state.stale
            assert (state.time, state.sequence) == (before.time, before.sequence)
        assert not robot.receive().stale
        assert robot.figures.stale == 3
        copy = arm.message()
        arm.cycle = lambda: arm.send(copy)  # the network repeats an old packet
        assert robot.receive().stale


def test_nothing_is_sent_in_answer_to_nothing():
    with stepped() as robot:
        arm = robot.arm
        goal = speed_up(robot)
        arm.listen()
        count = len(arm.answers)
        robot.lose_measurements(20)
        for _ in range(20):
            robot.send(position(goal))
            robot.receive()
        arm.listen()
        assert len(arm.answers) == count  # the last packet that came is answered already
        for _ in range(20):
            robot.send(position(goal))
            robot.receive()
        path = positions_of(arm)
        assert robot.limited_at_wire == 0  # the set-point has waited
    step = robot.spec.limits.velocity * robot.spec.period
    assert (np.abs(np.diff(path, axis=0)) <= step * (1 + 1e-5)).all()


def test_what_piled_up_in_a_stall_is_no_jump_and_no_fresh_state():
    with stepped() as robot:
        arm = robot.arm
        goal = speed_up(robot, 100)
        arm.listen()
        count = len(arm.answers)
        before = robot.receive().sequence
        robot.send(position(goal))
        keep_kernel_time(robot, on=True)
        for _ in range(30):  # cycles in which this machine does nothing
            arm.cycle()
        time.sleep(4 * STALL)
        assert robot.receive().sequence == before + 31  # with the one of this cycle
        keep_kernel_time(robot, on=False)
        arm.listen()
        assert len(arm.answers) == count + 1
        for _ in range(20):
            robot.send(position(goal))
            robot.receive()
        path = positions_of(arm)
    assert robot.figures.outdated == 30
    faster = np.abs(np.diff(path, n=2, axis=0)) / robot.spec.period
    assert (faster <= robot.spec.limits.acceleration * robot.spec.period * (1 + 1e-5)).all()
    step = robot.spec.limits.velocity * robot.spec.period * (1 + 1e-5)
    assert (np.abs(np.diff(path, axis=0)) <= step).all()


def test_torque_goes_on_unchanged_over_a_stall():
    with stepped(mode=CommandMode.TORQUE) as robot:
        arm = robot.arm
        robot.receive()
        for _ in range(20):
            robot.send(TorqueCommand(torque=np.full(7, 0.5)))
            robot.receive()
        robot.send(TorqueCommand(torque=np.full(7, 0.5)))
        keep_kernel_time(robot, on=True)
        for _ in range(10):
            arm.cycle()
        time.sleep(4 * STALL)
        robot.receive()
        keep_kernel_time(robot, on=False)
        robot.send(TorqueCommand(torque=np.full(7, 0.5)))
        arm.listen()
        assert {command.data.joint_torque for command in arm.answers[-10:]} == {(0.5,) * 7}
        assert arm.answers[-1].header.reflected == arm.sequence
        assert robot.figures.outdated == 10


def test_velocity_limit_guards_torque_sessions_too():
    with stepped(mode=CommandMode.TORQUE) as robot:
        robot.receive()
        push = np.zeros(7)
        push[6] = 30.0
        for _ in range(2000):
            robot.send(TorqueCommand(torque=push))
            if robot.receive().holding:
                break
        limits = robot.spec.limits
        with pytest.raises(HoldingError, match="joint 7 leaves its range or its velocity limit"):
            robot.send(TorqueCommand(torque=push))
        assert robot.arm.velocity[6] < 1.5 * limits.velocity[6]
        for _ in range(300):
            robot.receive()
        robot.arm.listen()
        torques = np.array([c.data.joint_torque for c in robot.arm.answers])
    assert not torques[-1].any()
    most = limits.torque_rate * robot.spec.period
    assert (np.abs(np.diff(torques, axis=0)) <= most * (1 + 1e-6)).all()


def test_commands_that_never_arrive_lead_to_a_hold():
    with stepped() as robot:
        robot.receive()
        robot.arm.deaf = 10**6
        for _ in range(300):
            if robot.receive().holding:
                break
            robot.send(position(POSE))
        with pytest.raises(HoldingError, match=r"received none of the last \d+ commands"):
            robot.send(position(POSE))


def test_poor_quality_is_seen():
    with stepped(quality=Quality.POOR) as robot:
        robot.receive()
        assert robot.quality is Quality.POOR


def test_application_position_that_no_arm_has_is_not_mirrored():
    with stepped(state=SessionState.COMMANDING_WAIT) as robot:
        arm = robot.arm
        for bad in (9.0, np.nan, np.inf, -1e300):
            arm.ipo = np.full(7, bad)
            robot.receive()
            assert arm.listen() == []


def unsaid(arm, measured):
    """Let an arm say nothing usable of where it is told to be."""
    plain = arm.message

    def message(**changes):
        told = plain(**changes)
        data = told.data._replace(measured_position=measured, commanded_position=(np.nan,) * 7)
        return told._replace(data=data, ipo=told.ipo._replace(joint_position=None))

    arm.message = message


def test_joined_session_that_does_not_say_where_it_stands_is_not_sent_to_zero():
    with stepped() as robot:
        unsaid(robot.arm, POSE)
        for _ in range(3):
            robot.receive()
        path = positions_of(robot.arm)
    assert path == pytest.approx(np.tile(POSE, (2, 1)))


@pytest.mark.parametrize("before", [None, SessionState.MONITORING_READY])
def test_where_nobody_knows_where_the_arm_stands_nothing_is_commanded(before):
    beyond, inside = (*POSE[:6], 3.066), (*POSE[:6], 3.06)  # by less than a jump
    with stepped() as robot:
        arm = robot.arm
        if before is not None:
            speed_up(robot, 50)
            arm.state = before
            arm.position = arm.ipo = np.array(beyond)
        unsaid(arm, beyond)
        robot.receive()
        arm.state = ACTIVE
        robot.receive()
        arm.listen()
        arm.answers.clear()
        robot.resume()
        for _ in range(5):
            robot.receive()
        assert arm.listen() == []
        assert not arm.answers
        del arm.message  # it says so again
        arm.position = arm.ipo = np.array(inside)
        for _ in range(3):
            robot.receive()
        path = positions_of(arm)
    assert path == pytest.approx(np.tile(inside, (2, 1)))


def test_arm_outside_its_range_is_not_commanded_there():
    with stepped(state=SessionState.COMMANDING_WAIT) as robot:
        arm = robot.arm
        arm.position = arm.ipo = np.full(7, 3.2)
        for state in (SessionState.COMMANDING_WAIT, ACTIVE):
            arm.state = state
            for _ in range(3):
                assert robot.receive().position == pytest.approx([3.2] * 7)
                assert arm.listen() == []
        with pytest.raises(BackendError, match="outside the joints' ranges"):
            robot.send(PositionCommand(position=np.zeros(7)))
