"""Others who send to the driver's port, and packets that no arm can have sent."""

import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from fri_messages import POSE
from robot_commands import position
from stepped_arm import SteppedArm, stepped, wake

from backends.fri import connection
from backends.fri.codec.messages import CommandMode, SessionState
from limo_driver.errors import BackendError, HoldingError
from limo_driver.types import TorqueCommand

pytestmark = pytest.mark.waits

ACTIVE = SessionState.COMMANDING_ACTIVE


def moving(robot, cycles=20):
    """Let the arm be commanded; return its last state."""
    state = robot.receive()
    for k in range(cycles):
        robot.send(position(np.array(POSE) + 1e-6 * k))
        state = robot.receive()
    return state


@pytest.fixture
def forger():
    """Somebody on the robot's own host, who knows everything but its port."""
    arm = SteppedArm()
    yield arm
    arm.close()


@pytest.mark.parametrize("state", list(SessionState))
def test_nobody_else_is_heard_from_the_address_of_the_robot(forger, state):
    with stepped() as robot:
        moving(robot)
        forger.port, forger.state = robot.arm.port, state
        forger.sequence, forger.ns = robot.arm.sequence + 1, robot.arm.ns + 10**6
        forger.ipo = np.array(POSE) + 0.5
        before = robot.foreign
        for k in range(10):
            forger.send()
            after = robot.receive()
            assert not after.holding
            assert after.position == pytest.approx(POSE, abs=1e-4)
            sent = robot.send(position(np.array(POSE) + 1e-6 * (20 + k)))
            assert np.abs(sent.position - POSE).max() < 1e-4
        for _ in range(100):  # the kernel may pass what two sockets sent in another order
            if robot.foreign == before + 10:
                break
            robot.receive()
        assert robot.foreign == before + 10
        figures = robot.link_figures()
        assert figures["last_foreign"] == ":".join(map(str, forger.socket.getsockname()))
        assert forger.listen() == []


@pytest.mark.slow("starts a Python, and commands an arm for 1 000 cycles")
def test_a_forger_in_another_process_changes_nothing():
    """The benchmark with fewer packets: of all kinds, ten for each of the robot's."""
    script = Path(__file__).parents[3] / "benchmarks" / "backends" / "fri_forger.py"
    done = subprocess.run(
        [sys.executable, str(script), "--packets", "10000"],
        check=False, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "10000 forged packets in 1000 cycles: 0 effects" in done.stdout


@pytest.mark.parametrize("where", ["ipo", "position"])
@pytest.mark.parametrize("state", [ACTIVE, SessionState.COMMANDING_WAIT])
def test_poses_that_jump_have_no_effect_and_are_told(where, state):
    """Even from the robot itself: one packet between two that are right."""
    with stepped() as robot:
        moving(robot)
        arm = robot.arm
        arm.sequence += 1
        false = arm.message()
        shifted = tuple(np.array(POSE) + 0.5)
        if where == "ipo":
            false = false._replace(ipo=false.ipo._replace(joint_position=shifted))
        else:
            false = false._replace(data=false.data._replace(measured_position=shifted))
        arm.send(false._replace(connection=false.connection._replace(session_state=state)))
        after = robot.receive()
        assert not after.holding
        assert after.position == pytest.approx(POSE, abs=1e-4)
        assert robot.figures.implausible == 1
        assert "a jump needs a new session" in robot.malformed
        assert np.abs(robot.setpoint - POSE).max() < 1e-4


def test_an_arm_that_really_jumped_is_taken_up_in_a_new_session():
    with stepped() as robot:
        moving(robot)
        arm = robot.arm
        arm.position = arm.ipo = np.array(POSE) + 0.5
        arm.obey = lambda: None
        for _ in range(5):
            assert robot.receive().stale
        arm.state = SessionState.IDLE
        assert robot.receive().position == pytest.approx(np.array(POSE) + 0.5)
        arm.state = ACTIVE
        assert robot.receive().holding
        with pytest.raises(HoldingError, match="left COMMANDING_ACTIVE"):
            robot.send(position(arm.position))


@pytest.mark.parametrize("pace", [(1, 1), (5, 3)])
@pytest.mark.parametrize("state", list(SessionState))
def test_nobody_else_is_heard_however_long_the_robot_is_silent(forger, monkeypatch, state, pace):
    """Whatever it says: a robot that restarted elsewhere could not be told from a forger."""
    with stepped() as robot:
        moving(robot)
        arm, peer, before = robot.arm, robot._link.endpoint.peer, robot.foreign
        forger.port, forger.state = arm.port, state
        forger.period_ms, forger.multiplier = pace
        forger.ns = arm.ns + 3600 * 10**9
        hour = SimpleNamespace(monotonic=lambda: time.monotonic() + 3600.0, time_ns=time.time_ns)
        monkeypatch.setattr(connection, "time", hour)
        monkeypatch.setattr(arm, "cycle", forger.send)
        for _ in range(5):
            assert robot.receive().stale
        assert robot.foreign == before + 5
        assert robot._link.endpoint.peer == peer
        monkeypatch.undo()
        state = robot.receive()
        assert not state.stale
        assert not state.holding
        assert np.abs(robot.send(position(arm.position)).position - POSE).max() < 1e-4
        assert forger.listen() == []


def test_a_robot_that_restarted_is_taken_up_from_its_own_port():
    with stepped() as robot:
        moving(robot)
        arm = robot.arm
        arm.sequence, arm.ns, arm.state = -1, arm.ns + 2 * 10**9, SessionState.MONITORING_WAIT
        state = robot.receive()
        assert not state.stale
        assert state.holding
        assert robot.figures.restarts == 1


def test_a_robot_that_restarted_elsewhere_is_taken_up_when_it_is_opened_again(forger):
    with stepped() as robot:
        moving(robot)
        forger.port, forger.state = robot.arm.port, SessionState.MONITORING_WAIT
        forger.sequence, forger.ns = robot.arm.sequence + 1, robot.arm.ns + 2 * 10**9
        robot.arm.cycle = forger.send
        assert robot.receive().stale
        with pytest.raises(BackendError, match=r"if it restarted on another port, open it again"):
            robot.wait_until_ready(timeout=0.0)
    with wake(forger) as robot:
        forger.cycle()
        assert not robot.receive().stale


@pytest.mark.parametrize("mode", [CommandMode.POSITION, CommandMode.TORQUE])
def test_send_returns_what_left_for_the_robot(mode):
    """The last packet's answer is one; what comes after it in a cycle has to wait."""
    with stepped(mode=mode) as robot:
        robot.receive()
        far = np.array(POSE) + 0.015
        one, other = (
            (position(far), position(POSE))
            if mode is CommandMode.POSITION
            else (TorqueCommand(torque=np.full(7, 50.0)), TorqueCommand(torque=np.zeros(7)))
        )
        name = "position" if mode is CommandMode.POSITION else "torque"
        for _ in range(5):
            first = robot.send(one)
            again = robot.send(other)
            robot.arm.listen()
            data = robot.arm.answers[-1].data
            left = data.joint_position if name == "position" else data.joint_torque
            assert getattr(first, name) == pytest.approx(left, abs=0)
            assert getattr(again, name) == pytest.approx(left, abs=0)
            assert "link" in again.limited_by
            robot.receive()


def test_send_says_that_nothing_left_while_packets_are_lost():
    with stepped() as robot:
        moving(robot)
        robot.lose_measurements(2)
        robot.receive()
        last = robot.setpoint
        sent = robot.send(position(np.array(POSE) + 0.01))
        assert sent.limited_by[-1] == "link"
        assert np.array_equal(sent.position, last)
