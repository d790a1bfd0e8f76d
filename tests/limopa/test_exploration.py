"""Paths: how they explore poses, and limits that hold between samples of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import ConfigError
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointLimits
from limopa import Exploring, PlanRequest, Reaching, Surroundings, Workspace
from limopa.path import OVERSHOOT, JointBounds, Line, retime
from limopa.scaffold import draw_exploration

SCAFFOLD = np.array([0.3, -0.5, 1.0])


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_draws_stay_in_their_ranges(seed):
    ranges = Exploring()
    path = draw_exploration(SCAFFOLD, ranges, np.random.default_rng(seed))
    for name in ("amplitude", "frequency", "phase"):
        low, high = getattr(ranges, name)
        values = getattr(path, name)
        assert values.shape == (3, 3)
        assert low <= values.min()
        assert values.max() <= high
    assert 2000 <= path.waypoints <= 2500


def test_path_starts_at_the_scaffold_and_is_the_sinusoids():
    path = draw_exploration(SCAFFOLD, Exploring(), np.random.default_rng(0))
    s = np.linspace(0, path.length, 777)
    sinusoids = np.zeros((777, 3))
    for j in range(3):
        for k in range(3):
            angle = 2 * np.pi * path.frequency[j, k] * s + path.phase[j, k]
            sinusoids[:, j] += path.amplitude[j, k] * np.sin(angle)
    np.testing.assert_allclose(path.derivative(s, 0)[0], SCAFFOLD, atol=1e-14)
    offset = path.derivative(s, 0) - sinusoids
    np.testing.assert_allclose(offset, np.tile(offset[0], (777, 1)), atol=1e-13)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_derivatives_follow_each_other(order):
    path = draw_exploration(SCAFFOLD, Exploring(), np.random.default_rng(1))
    s, h = np.linspace(0.1, path.length - 0.1, 50), 1e-5
    numeric = (path.derivative(s + h, order) - path.derivative(s - h, order)) / (2 * h)
    exact = path.derivative(s, order + 1)
    np.testing.assert_allclose(numeric, exact, atol=1e-6 * np.abs(exact).max())


def test_peaks_bound_the_derivatives_between_waypoints():
    path = draw_exploration(SCAFFOLD, Exploring(waypoint_period=0.02), np.random.default_rng(2))
    fine = np.linspace(0, path.length, 200_001)
    for order, peak in enumerate(path.peaks(), start=1):
        true = np.abs(path.derivative(fine, order)).max(axis=0)
        assert np.all(true <= peak)
        assert np.all(peak <= 1.2 * true)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: PlanRequest(scaffolds=0), "scaffolds is 0, expected a whole number of 1 or more"),
        (lambda: PlanRequest(rate=1), "rate is 1 Hz, expected a number from 50 to 10000 Hz"),
        (lambda: Workspace(radius=-1), "workspace: radius is -1 m, expected a number above 0 m"),
        (
            lambda: Workspace(lower=(1, 0, 0), upper=(0, 1, 1)),
            "workspace: lower is .1, 0, 0., expected less than upper",
        ),
        (
            lambda: Surroundings(clearance=0),
            "clearance is 0 m, expected a number above 0 and up to 1 m",
        ),
        (
            lambda: Surroundings(joint_margin=-0.1),
            "joint_margin is -0.1 rad, expected a number of 0 rad or more",
        ),
        (
            lambda: Surroundings(table_height=float("nan")),
            "table_height is nan m, expected a number",
        ),
        (
            lambda: Exploring(velocity=(0.1, 1.2)),
            "exploring: velocity is 1.2, expected a list of 2 numbers above 0 and up to 1",
        ),
        (
            lambda: Exploring(amplitude=(0.2, 0.1)),
            "exploring: amplitude is .* expected numbers that increase, not 0.1 after 0.2",
        ),
        (
            lambda: Exploring(waypoints=(1, 5)),
            "exploring: waypoints is 1, expected a list of 2 whole numbers of 2 or more",
        ),
        (lambda: Reaching(acceleration=(0.0, 0.5)), "reaching: acceleration is 0"),
    ],
)
def test_a_request_that_cannot_be_says_why(make, named):
    with pytest.raises(ConfigError, match=named):
        make()


RELATIVE = 1 + 1e-6


def _limits(velocity, acceleration_per_velocity, jerk_per_velocity) -> JointLimits:
    n = len(velocity)
    return JointLimits(
        position_min=np.full(n, -3.0),
        position_max=np.full(n, 3.0),
        velocity=velocity,
        acceleration=acceleration_per_velocity * velocity,
        jerk=jerk_per_velocity * velocity,
        torque=np.ones(n),
        torque_rate=np.ones(n),
    )


def _trajectory(path, bounds, period) -> Trajectory:
    timed = retime(path, bounds, period)
    time = np.arange(len(timed.parameter)) * period
    return Trajectory(time, timed.position, timed.velocity, timed.acceleration)


def _assert_within(motion: Trajectory, limits: JointLimits) -> None:
    """Check the quintics analytically, and what a robot at 1 kHz sees by differences."""
    peaks = motion.peaks()
    assert np.all(peaks.velocity <= limits.velocity * RELATIVE)
    assert np.all(peaks.acceleration <= limits.acceleration * RELATIVE)
    assert np.all(peaks.jerk <= limits.jerk * RELATIVE)
    time = np.arange(0, motion.duration, 1e-3)
    sampled = motion.evaluate(time)
    assert np.all(np.abs(sampled.velocity) <= limits.velocity * RELATIVE)
    assert np.all(np.abs(sampled.acceleration) <= limits.acceleration * RELATIVE)
    jerk = np.diff(sampled.acceleration, axis=0) / 1e-3
    assert np.all(np.abs(jerk) <= limits.jerk * RELATIVE + 1e-9)
    third = np.diff(sampled.position, n=3, axis=0) / 1e-9
    rounding = 8 * 4e-16 * 4 / 1e-9  # of positions below 4 rad, in a third difference
    assert np.all(np.abs(third) <= limits.jerk * RELATIVE + rounding)


LIMITS = st.builds(
    _limits,
    velocity=st.lists(st.floats(0.3, 3.0), min_size=3, max_size=3).map(np.array),
    acceleration_per_velocity=st.floats(2.0, 15.0),
    jerk_per_velocity=st.floats(15.0, 150.0),
)
PERIOD = st.sampled_from([1e-3, 4e-3, 1e-2])


@given(LIMITS, PERIOD, st.floats(1e-4, 4.0), st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_reaching_keeps_all_limits_at_full_speed(limits, period, distance, seed):
    direction = np.random.default_rng(seed).uniform(-1, 1, 3)
    end = distance * direction / np.abs(direction).max()
    motion = _trajectory(Line(np.zeros(3), end), JointBounds.of(limits, period), period)
    _assert_within(motion, limits)
    np.testing.assert_allclose(motion.position[-1], end, atol=1e-15)
    along = motion.position @ end / (end @ end)
    np.testing.assert_allclose(motion.position, np.outer(along, end), atol=1e-12)
    _assert_at_rest(motion)


@given(LIMITS, PERIOD, st.floats(0.05, 1.0), st.integers(0, 1000))
@settings(max_examples=15, deadline=None)
def test_exploring_keeps_all_limits(limits, period, share, seed):
    ranges = Exploring(waypoints=(60, 100), waypoint_period=0.01)
    path = draw_exploration(np.zeros(3), ranges, np.random.default_rng(seed))
    motion = _trajectory(path, JointBounds.of(limits, period, share), period)
    _assert_within(motion, limits)
    assert np.all(np.abs(motion.velocity) <= share * limits.velocity * RELATIVE)
    _assert_at_rest(motion)


def _assert_at_rest(motion: Trajectory) -> None:
    for row in (0, -1):
        assert np.abs(motion.velocity[row]).max() == 0.0
        assert np.abs(motion.acceleration[row]).max() == 0.0


def test_exploring_runs_at_the_relative_velocity_asked_for():
    limits = _limits(np.array([1.5, 1.5, 2.3]), 5.0, 50.0)
    path = draw_exploration(np.zeros(3), Exploring(), np.random.default_rng(0))
    motion = _trajectory(path, JointBounds.of(limits, 4e-3, 0.2), 4e-3)
    assert (motion.peaks().velocity / limits.velocity).max() == pytest.approx(0.2, rel=2e-3)


def test_overshoot_bounds_the_projection_onto_quadratics():
    """The quintic's jerk is the L2 projection of the true jerk; its kernel at u = 1 is worst."""
    nodes = np.linspace(-1, 1, 20_001)
    weights = np.full(nodes.size, nodes[1] - nodes[0])
    basis = np.polynomial.legendre.legvander(nodes, 2) * np.sqrt([0.5, 1.5, 2.5])
    ends = np.polynomial.legendre.legvander(np.linspace(-1, 1, 21), 2) * np.sqrt([0.5, 1.5, 2.5])
    constant = (np.abs(ends @ basis.T) * weights).sum(axis=1).max()
    assert 0.995 * OVERSHOOT < constant <= 1.001 * OVERSHOOT


def test_samples_too_far_apart_are_refused():
    limits = _limits(np.ones(2), 1.0, 500.0)
    with pytest.raises(ConfigError, match="sample rate is 50 Hz, too low"):
        JointBounds.of(limits, 0.02)
