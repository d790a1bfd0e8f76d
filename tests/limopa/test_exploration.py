from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import ConfigError
from limopa import Exploring, PlanRequest, Reaching, Surroundings, Workspace
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
