"""What every backend promises; written once, run for all that are registered."""

from importlib.metadata import entry_points

import numpy as np
import pytest
from robot_commands import START, follow, position, smooth_move

from limo_driver.errors import (
    BackendError,
    BackendNotFoundError,
    ConfigError,
    ConnectionLostError,
    CycleTimeoutError,
    JointLimitError,
    ShapeError,
)
from limo_driver.robot.registry import open_robot
from limo_driver.runtime.plugins import ROBOTS
from limo_driver.types import TorqueCommand


def test_both_simulations_are_registered():
    assert {"mujoco", "virtual"} <= {entry.name for entry in entry_points(group=ROBOTS)}


def test_unknown_backend_names_the_known_ones():
    with pytest.raises(BackendNotFoundError, match="mujoco, virtual"):
        open_robot("nope")


def test_time_starts_at_zero_and_advances_by_cycles(robot):
    states = [robot.receive() for _ in range(5)]
    assert [s.time for s in states] == pytest.approx([k * robot.spec.period for k in range(5)])
    assert [s.sequence for s in states] == list(range(5))


def test_uncommanded_arm_stands_still(robot):
    states = [robot.receive() for _ in range(200)]
    assert np.abs(states[-1].position - START).max() < 1e-6
    assert not states[-1].holding
    gravity = robot.simulation.model.gravity_torque(np.array([START]))[0]
    assert np.abs(states[-1].torque - gravity).max() < 1e-3


def test_starts_from_any_pose_within_the_limits(backend):
    random = np.random.default_rng(3)
    with open_robot(backend, robot="iiwa14") as any_robot:
        limits = any_robot.spec.limits
    for _ in range(5):
        pose = random.uniform(limits.position_min, limits.position_max)
        with open_robot(backend, robot="iiwa14", initial_position=pose) as robot:
            state = [robot.receive() for _ in range(50)][-1]
        assert np.abs(state.position - pose).max() < 1e-6


def test_initial_position_outside_the_range_is_refused(backend):
    with pytest.raises(JointLimitError, match="joint 2: initial position"):
        open_robot(backend, robot="iiwa14", initial_position=[0, 9, 0, 0, 0, 0, 0])


def test_feasible_motion_is_followed_unchanged(robot):
    targets = smooth_move(0.1, 500)
    states, sent = follow(robot, targets)
    assert all(command.limited_by == () for command in sent)
    assert all(np.array_equal(c.position, t) for c, t in zip(sent, targets, strict=True))
    assert np.abs(states[-1].position - targets[-1]).max() < 2e-4


def test_send_before_receive_is_refused(robot):
    with pytest.raises(BackendError, match="receive"):
        robot.send(position(START))


def test_first_command_far_from_the_measured_pose_is_refused(robot):
    robot.receive()
    far = np.array(START) + 0.1 * np.eye(7)[2]
    with pytest.raises(JointLimitError, match=r"joint 3: first position.*measured pose"):
        robot.send(position(far))
    state = [robot.receive() for _ in range(20)][-1]
    assert np.abs(state.position - START).max() < 1e-6


def test_first_command_within_tolerance_is_approached_within_the_limits(robot):
    near = np.array(START) + 0.015
    _, sent = follow(robot, [near] * 300)
    check_setpoints(robot, sent)
    assert sent[0].limited_by
    assert np.array_equal(sent[-1].position, near)


def test_limited_command_is_returned_and_converges_without_overshoot(robot):
    goal = np.array(START) + 0.4
    targets = [START, *[goal] * 1500]
    states, sent = follow(robot, targets)
    check_setpoints(robot, sent)
    assert {"velocity", "acceleration"} <= set(sent[1].limited_by)
    assert max((c.position - goal).max() for c in sent) < 1e-9
    assert np.abs(sent[-1].position - goal).max() < 1e-9
    assert np.abs(states[-1].position - goal).max() < 1e-3


def test_range_is_kept_and_said(robot):
    upper = robot.spec.limits.position_max
    targets = np.linspace(START, upper + 0.3, 3500)
    _, sent = follow(robot, targets)
    check_setpoints(robot, sent)
    assert max((c.position - upper).max() for c in sent) <= 1e-12
    assert "position" in sent[-1].limited_by


def check_setpoints(robot, sent):
    """All set-points keep velocity and acceleration, from standstill on."""
    limits, period = robot.spec.limits, robot.spec.period
    path = np.array([START, START, *[command.position for command in sent]])
    velocity = np.diff(path, axis=0) / period
    acceleration = np.diff(velocity, axis=0) / period
    assert (np.abs(velocity) <= limits.velocity * (1 + 1e-5)).all()
    assert (np.abs(acceleration) <= limits.acceleration * (1 + 1e-5)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_command_that_is_not_finite_is_refused(robot, bad):
    robot.receive()
    broken = np.array(START)
    broken[4] = bad
    with pytest.raises(JointLimitError, match="joint 5: position"):
        robot.send(position(broken))
    with pytest.raises(JointLimitError, match="joint 5: torque"):
        robot.send(TorqueCommand(torque=broken))
    assert np.abs(robot.receive().position - START).max() < 1e-6


def test_command_for_another_number_of_joints_is_refused(robot):
    robot.receive()
    with pytest.raises(ShapeError, match=r"\(7,\)"):
        robot.send(position([0.0] * 6))


@pytest.mark.parametrize("valid_for", [0.0, -1.0, 1.001, 1e300, np.nan, np.inf])
def test_validity_has_to_be_a_time(robot, valid_for):
    robot.receive()
    with pytest.raises(ConfigError, match="valid_for"):
        robot.send(position(START, valid_for=valid_for))


def test_refused_command_leaves_the_one_in_force(robot):
    targets = smooth_move(0.05, 300)
    follow(robot, targets[:150])
    with pytest.raises(JointLimitError):
        robot.send(position([np.nan] * 7))
    state = robot.receive()
    assert not state.holding
    robot.send(position(targets[150]))


def test_lost_measurement_is_flagged_and_never_zero(robot):
    before = [robot.receive() for _ in range(3)][-1]
    robot.lose_measurements(2)
    lost = [robot.receive(), robot.receive()]
    after = robot.receive()
    for state in lost:
        assert state.stale
        assert state.time == before.time
        assert state.sequence == before.sequence
        assert np.array_equal(state.position, before.position)
        assert np.array_equal(state.torque, before.torque)
    assert not after.stale
    assert after.sequence == before.sequence + 3  # the gap shows


def test_nothing_ever_measured_is_a_timeout(robot):
    robot.lose_measurements(1)
    with pytest.raises(CycleTimeoutError):
        robot.receive(timeout=0.01)


def test_last_command_of_a_cycle_counts(robot):
    robot.receive()
    robot.send(position(START))
    robot.receive()
    robot.send(position(np.array(START) + 0.01))
    again = robot.send(position(START))
    assert np.array_equal(again.position, START)


def test_close_is_idempotent_and_final(backend):
    robot = open_robot(backend, robot="iiwa14")
    state = robot.receive()
    robot.close()
    robot.close()
    with pytest.raises(ConnectionLostError, match="closed"):
        robot.send(position(state.position))
    with pytest.raises(ConnectionLostError, match="closed"):
        robot.receive()
    with pytest.raises(ConnectionLostError, match="closed"):
        robot.resume()


def test_with_closes_also_after_an_error(backend):
    with pytest.raises(ZeroDivisionError), open_robot(backend, robot="iiwa14") as robot:
        raise ZeroDivisionError
    with pytest.raises(ConnectionLostError):
        robot.receive()


def test_states_cannot_be_written_to(robot):
    with pytest.raises(ValueError, match="read-only"):
        robot.receive().position[0] = 1.0


def test_same_seed_same_bits(backend, hysteretic):
    def signals(seed):
        with open_robot(backend, simulation=hysteretic, initial_position=START, seed=seed) as robot:
            states, _ = follow(robot, smooth_move(0.02, 60))
        return np.array([np.concatenate([s.position, s.velocity, s.torque]) for s in states])

    assert np.array_equal(signals(5), signals(5))
    assert not np.array_equal(signals(5), signals(6))


def test_restored_state_continues_bit_for_bit(backend, hysteretic):
    targets = smooth_move(0.05, 400)
    with open_robot(backend, simulation=hysteretic, initial_position=START, seed=1) as robot:
        follow(robot, targets[:200])
        saved = robot.save_state()
        first, sent = follow(robot, targets[200:])
        robot.restore_state(saved)
        second, sent_again = follow(robot, targets[200:])
    for one, other in zip([*first, *sent], [*second, *sent_again], strict=True):
        for name, value in vars(one).items():
            assert np.array_equal(value, getattr(other, name)), name
