"""Limits hold between samples, not only on them, for random paths, limits and sample rates."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import ConfigError
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointLimits
from limopa import Exploring
from limopa.path import OVERSHOOT, JointBounds, Line, retime
from limopa.scaffold import draw_exploration

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
