"""What every backend promises under torque and impedance control."""

import numpy as np
import pytest
from lanes import sampled
from robot_commands import START, impedance, position

from limo_driver.errors import HoldingError, JointLimitError
from limo_driver.types import ImpedanceCommand, TorqueCommand


def test_torque_and_its_rate_are_limited(robot):
    limits, period = robot.spec.limits, robot.spec.period
    robot.receive()
    first = robot.send(TorqueCommand(torque=10 * limits.torque))
    assert set(first.limited_by) == {"torque", "torque_rate"}
    assert np.allclose(first.torque, limits.torque_rate * period)
    robot.receive()
    second = robot.send(TorqueCommand(torque=-limits.torque))
    assert np.allclose(second.torque, 0.0)


def test_zero_torque_floats_under_compensated_gravity(robot):
    robot.receive()
    for _ in range(300):
        robot.send(TorqueCommand(torque=np.zeros(7)))
        state = robot.receive()
    assert not state.holding
    assert np.abs(state.position - START).max() < 1e-3


def test_arm_that_runs_away_under_torque_is_held(robot):
    robot.receive()
    push = TorqueCommand(torque=8.0 * np.eye(7)[6])
    for _ in range(5000):
        robot.send(push)
        if robot.receive().holding:
            break
    with pytest.raises(HoldingError, match="joint 7"):
        robot.send(push)
    for _ in range(2000):
        state = robot.receive()
    assert robot.standing
    assert np.abs(state.velocity).max() < 1e-2


def test_impedance_gives_way_like_a_spring(robot):
    robot.receive()
    stiffness, push = np.full(7, 400.0), np.array([0, 0, 0, 4.0, 0, 0, 2.0])
    for _ in range(3000):
        robot.send(
            ImpedanceCommand(
                position=START, stiffness=stiffness, damping=0.1 * stiffness, torque=push
            )
        )
        state = robot.receive()
    assert state.position - START == pytest.approx(push / stiffness, abs=1e-4)


def test_changing_the_control_mode_starts_from_the_measured_pose(robot):
    robot.receive()
    for _ in range(200):
        robot.send(TorqueCommand(torque=np.array([1.0, 0, 0, 0, 0, 0, 0])))
        state = robot.receive()
    with pytest.raises(JointLimitError, match="first position"):
        robot.send(position(state.position + 0.1))
    sent = robot.send(position(state.position))
    assert np.abs(sent.position - state.position).max() < 1e-2


def test_negative_stiffness_is_refused(robot):
    robot.receive()
    zero = np.zeros(7)
    with pytest.raises(JointLimitError, match="joint 1: stiffness"):
        robot.send(ImpedanceCommand(position=START, stiffness=zero - 1, damping=zero, torque=zero))


def deflect(robot, stiffness=300.0):
    """Push joint 1 off its set-point under impedance control, by some 0.1 rad."""
    robot.receive()
    for k in range(2000):
        push = min(30.0, 0.03 * k) * np.eye(7)[0]
        robot.send(impedance(START, stiffness, 0.1 * stiffness, push))
        state = robot.receive()
    assert state.position[0] - START[0] > 0.09
    return state


@sampled("how", ["hold", "expiry"], "seconds of cycles each")
def test_deflected_arm_is_held_where_it_is(robot, how):
    deflected = deflect(robot)
    if how == "hold":
        robot.hold()
    states = [robot.receive() for _ in range(400)]
    assert states[-1].holding
    # The push goes on until the command expires; then nothing jumps.
    assert max(np.abs(state.velocity).max() for state in states) < 0.15
    assert np.abs(states[-1].position - deflected.position).max() < 0.01


@pytest.mark.slow("seconds of cycles")
def test_deflected_arm_takes_positions_only_from_its_pose(robot):
    deflected = deflect(robot)
    with pytest.raises(JointLimitError, match="joint 1: first position"):
        robot.send(position(START))
    targets = [robot.send(position(deflected.position)).position]
    states = [robot.receive()]
    for _ in range(100):
        targets.append(robot.send(position(deflected.position)).position)
        states.append(robot.receive())
    assert np.abs(np.array(targets) - deflected.position).max() < 2e-3
    assert max(np.abs(state.velocity).max() for state in states) < 0.15


@pytest.mark.parametrize("name", ["stiffness", "damping"])
def test_gain_beyond_the_robot_is_refused_and_not_in_force(robot, name):
    robot.receive()
    for _ in range(3):
        robot.send(impedance(START))
        robot.receive()
    with pytest.raises(JointLimitError, match=name):
        robot.send(impedance(START, **{name: 1e300}))
    states = [robot.receive() for _ in range(50)]
    assert not states[-1].holding
    assert np.abs(states[-1].position - START).max() < 1e-3
