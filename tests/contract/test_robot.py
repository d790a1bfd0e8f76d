"""What every backend promises; written once, run for all that are registered."""

from importlib.metadata import entry_points

import numpy as np
import pytest

from limo_driver.errors import (
    BackendError,
    BackendNotFoundError,
    ConfigError,
    ConnectionLostError,
    CycleTimeoutError,
    HoldingError,
    JointLimitError,
    ShapeError,
)
from limo_driver.registry import ROBOTS, open_robot
from limo_driver.types import ImpedanceCommand, PositionCommand, TorqueCommand

START = (0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0)
BACKENDS = sorted(entry.name for entry in entry_points(group=ROBOTS))


@pytest.fixture(params=BACKENDS)
def backend(request):
    return request.param


@pytest.fixture
def robot(backend):
    with open_robot(backend, robot="iiwa14", initial_position=START) as opened:
        yield opened


def position(values, **options):
    return PositionCommand(position=np.asarray(values, dtype=float), **options)


def follow(robot, targets):
    """Send each target in answer to a state; return states and what was sent."""
    state = robot.receive()
    states, sent = [], []
    for target in targets:
        sent.append(robot.send(position(target)))
        state = robot.receive()
        states.append(state)
    return states, sent


def smooth_move(distance, cycles):
    s = np.linspace(0.0, 1.0, cycles)[:, None]
    return np.array(START) + distance * (10 * s**3 - 15 * s**4 + 6 * s**5)


def test_both_simulations_are_registered():
    assert {"mujoco", "virtual"} <= set(BACKENDS)


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
    targets = np.linspace(START, upper + 0.3, 6000)
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


def test_negative_stiffness_is_refused(robot):
    robot.receive()
    zero = np.zeros(7)
    with pytest.raises(JointLimitError, match="joint 1: stiffness"):
        robot.send(ImpedanceCommand(position=START, stiffness=zero - 1, damping=zero, torque=zero))


def test_refused_command_leaves_the_one_in_force(robot):
    targets = smooth_move(0.05, 300)
    follow(robot, targets[:150])
    with pytest.raises(JointLimitError):
        robot.send(position([np.nan] * 7))
    state = robot.receive()
    assert not state.holding
    robot.send(position(targets[150]))


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
    limits, period = robot.spec.limits, robot.spec.period
    acceleration = np.diff(path, n=2, axis=0) / period**2
    assert (np.abs(acceleration) <= limits.acceleration * (1 + 1e-5)).all()
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
    limits, period = robot.spec.limits, robot.spec.period
    acceleration = np.diff(path, n=2, axis=0) / period**2
    assert (np.abs(acceleration) <= limits.acceleration * (1 + 1e-5)).all()
    assert len(path) > 210  # it took a while: nothing stops at once


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


def impedance(values, stiffness=300.0, damping=30.0, torque=None):
    zero = np.zeros(7)
    return ImpedanceCommand(
        position=np.asarray(values, dtype=float),
        stiffness=zero + stiffness,
        damping=zero + damping,
        torque=zero if torque is None else np.asarray(torque, dtype=float),
    )


def deflect(robot, stiffness=300.0):
    """Push joint 1 off its set-point under impedance control, by some 0.1 rad."""
    robot.receive()
    for k in range(2000):
        push = min(30.0, 0.03 * k) * np.eye(7)[0]
        robot.send(impedance(START, stiffness, 0.1 * stiffness, push))
        state = robot.receive()
    assert state.position[0] - START[0] > 0.09
    return state


@pytest.mark.parametrize("how", ["hold", "expiry"])
def test_deflected_arm_is_held_where_it_is(robot, how):
    deflected = deflect(robot)
    if how == "hold":
        robot.hold()
    states = [robot.receive() for _ in range(400)]
    assert states[-1].holding
    # The push goes on until the command expires; then nothing jumps.
    assert max(np.abs(state.velocity).max() for state in states) < 0.15
    assert np.abs(states[-1].position - deflected.position).max() < 0.01


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
    acceleration = np.diff(path, n=2, axis=0) / robot.spec.period**2
    assert (np.abs(acceleration) <= robot.spec.limits.acceleration * (1 + 1e-5)).all()
    if commanded:
        assert np.abs(path[-1] - goal).max() < 1e-9
    else:
        assert robot.standing


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
