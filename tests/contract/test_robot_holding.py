"""When every backend holds the arm, how it brakes, and what it takes to go on."""

import numpy as np
import pytest
from robot_commands import START, follow, position, smooth_move

from limo_driver.errors import BackendError, HoldingError, JointLimitError


def check_acceleration(robot, path):
    acceleration = np.diff(path, n=2, axis=0) / robot.spec.period**2
    assert (np.abs(acceleration) <= robot.spec.limits.acceleration * (1 + 1e-5)).all()


def test_expired_command_leads_to_a_hold_within_the_limits(robot):
    _, sent = follow(robot, smooth_move(0.3, 800)[:400])  # stop sending at full speed
    path, states = [command.position for command in sent], []
    for _ in range(600):
        states.append(robot.receive())
        path.append(robot.setpoint)
    held = [state.holding for state in states]
    assert held.index(True) in range(98, 102)  # valid for 0.1 s
    assert robot.standing
    assert np.abs(states[-1].velocity).max() < 1e-3
    assert np.abs(states[-1].position - path[-1]).max() < 1e-4
    check_acceleration(robot, path)
    with pytest.raises(HoldingError, match=r"expired after 0.1 s.*resume"):
        robot.send(position(states[-1].position))


def test_nothing_resumes_without_being_told(robot):
    robot.receive()
    robot.send(position(START))
    robot.hold("a light curtain was broken")
    for _ in range(50):
        assert robot.receive().holding
        with pytest.raises(HoldingError, match="light curtain"):
            robot.send(position(START))
    robot.resume()
    state = robot.receive()
    assert not state.holding
    robot.send(position(state.position))


def test_resuming_starts_from_the_measured_pose(robot):
    follow(robot, smooth_move(0.1, 300))
    robot.hold()
    for _ in range(100):
        state = robot.receive()
    robot.resume()
    with pytest.raises(JointLimitError, match="first position"):
        robot.send(position(START))
    assert np.abs(robot.send(position(state.position)).position - state.position).max() < 1e-4


def test_hold_from_full_speed_keeps_the_limits(robot):
    _, sent = follow(robot, smooth_move(0.3, 400)[:200])
    robot.hold()
    path = [command.position for command in sent]
    while not robot.standing:
        robot.receive()
        path.append(robot.setpoint)
    check_acceleration(robot, path)
    assert len(path) > 210  # it took a while: nothing stops at once


@pytest.mark.parametrize("answered", [False, True])
@pytest.mark.parametrize("resumed", [False, True])
def test_closing_at_full_speed_brakes_within_the_limits(robot, answered, resumed):
    moves = smooth_move(0.3, 400)[:201]
    _, sent = follow(robot, moves[:200])
    path, receive = [command.position for command in sent], robot._receive
    if answered:
        robot.send(position(moves[200]))
    if resumed:  # and nothing commanded since
        robot.hold()
        robot.resume()

    def noted(timeout):
        path.append(robot._contract.following.position)
        return receive(timeout)

    robot._receive = noted
    robot.close()
    assert robot.standing
    assert len(path) > 210
    assert np.array_equal(path[-1], path[-2])
    check_acceleration(robot, path)


def test_hold_asked_for_after_a_command_keeps_the_limits(robot):
    moves = smooth_move(0.3, 400)[:201]
    _, sent = follow(robot, moves[:200])
    sent.append(robot.send(position(moves[200])))
    robot.hold()
    path = [command.position for command in sent]
    robot.receive()
    while not robot.standing:
        robot.receive()
        path.append(robot.setpoint)
    check_acceleration(robot, path)


@pytest.mark.parametrize("commanded", [False, True])
def test_resuming_while_braking_keeps_the_limits(robot, commanded):
    _, sent = follow(robot, smooth_move(0.3, 400)[:200])
    robot.hold()
    path = [command.position for command in sent]
    for _ in range(2):
        state = robot.receive()
        path.append(robot.setpoint)
    robot.resume()
    assert not robot.standing
    goal = state.position
    for _ in range(800):
        if commanded:
            robot.send(position(goal))
        robot.receive()
        path.append(robot.setpoint)
    check_acceleration(robot, path)
    if commanded:
        assert np.abs(path[-1] - goal).max() < 1e-9
    else:
        assert robot.standing


def test_long_loss_of_measurements_leads_to_a_hold(robot):
    robot.receive()
    robot.lose_measurements(1000)
    holding = []
    for _ in range(150):
        if not holding or not holding[-1]:
            robot.send(position(START))
        holding.append(robot.receive().holding)
    assert not holding[50]
    assert holding[-1]
    with pytest.raises(HoldingError, match="no measurement"):
        robot.send(position(START))


def test_stream_starts_only_from_a_fresh_measurement(robot):
    robot.receive()
    robot.lose_measurements(2)
    robot.receive()
    with pytest.raises(BackendError, match="measurement is lost"):
        robot.send(position(START))
    robot.hold()
    robot.receive()
    robot.resume()
    with pytest.raises(BackendError, match="measurement is lost"):
        robot.send(position(START))
    robot.receive()
    robot.send(position(START))
