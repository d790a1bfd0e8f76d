"""What a member removes counts where it acts, and only if another day would have shown it, too."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.from_torque.fitting import contribution
from estimators.diagnosis.from_torque.fitting.contribution import (
    convincing,
    error_removed,
    own_joints,
    puts_values_at_limits,
    surely_helps,
    surely_less,
)
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.diagnosis.stages import quiet
from limo_driver.physics import QuadraticDrag, SpringLoad, Tolerances, TorqueOffset


@pytest.fixture(scope="module")
def sprung():
    problem = RegressionProblem.of(observed(SpringLoad(joint=3, stiffness=2.0, rest=0.3)), quiet)
    return problem, Noise.independent(np.full(7, 0.02), problem.split.fitted)


def place_of(problem, effect, joint):
    """Return a candidate of an effect at a joint (1-based)."""
    places = [candidate.place for candidate in problem.candidates]
    return places.index((effect, (joint - 1,)))


def test_what_is_there_is_material_and_what_is_not_is_nothing(sprung):
    problem, noise = sprung
    spring, absent = place_of(problem, "spring_load", 3), place_of(problem, "quadratic_drag", 5)
    solution = fitted(problem, tuple(sorted((spring, absent))), noise)
    assert error_removed(solution, spring) > 3.0
    assert error_removed(solution, absent) == 0.0


@pytest.fixture
def of_torque(rigid, training_recording):
    """Make a problem of an arm, known well, that needs some torque (T,) more at joint 1."""
    known = replace(rigid, tolerances=Tolerances(inertia=1e-3, friction=1e-3))
    motion, random = training_recording.motion(10.0), np.random.default_rng(3)

    def make(added):
        torque = rigid.predict(motion) + 0.02 * random.standard_normal(motion.position.shape)
        torque[:, 0] += added(motion.position[:, 0])
        recording = replace(training_recording, torque=torque)
        problem = RegressionProblem.of(Observations.of(known, [recording], 10.0), quiet)
        return problem, Noise.independent(np.full(2, 0.02), problem.split.fitted)

    return make


def test_what_a_member_removes_is_counted_in_errors_that_are_left(of_torque):
    """Errors that do not depend on one another add up in squares."""
    problem, noise = of_torque(lambda q: 1.0 * (q - q.mean()))
    spring = place_of(problem, "spring_load", 1)
    solution = fitted(problem, (spring,), noise)
    moving = problem.observed.moving
    left = rmse(problem.left(solution.fitted), moving)[0]
    given = rmse(problem.observed.residual, moving)[0]
    expected = np.sqrt((given / left) ** 2 - 1.0)
    assert expected > 2.0
    assert error_removed(solution, spring) == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(("held_out", "is_sure"), [(1.0, True), (0.3, False)])
def test_what_raises_errors_of_the_motion_held_out_is_not_sure(of_torque, held_out, is_sure):
    """A spring lowers those of all other motion: there it is what it is fitted to."""

    def less_at_times(q):
        blocks = np.arange(q.size) * HELD_OUT.blocks // q.size
        return 0.5 * (q - q.mean()) * np.where(np.isin(blocks, HELD_OUT.which), held_out, 1.0)

    problem, noise = of_torque(less_at_times)
    spring = place_of(problem, "spring_load", 1)
    assert surely_helps(fitted(problem, (spring,), noise), spring) == is_sure


def test_what_fades_before_any_row_is_held_out_counts_over_all_rows_however_little(of_torque):
    """Rows held out have next to nothing of it, so they cannot say."""
    problem, noise = of_torque(lambda q: 0.04 * np.clip(1 - 5 * np.arange(q.size) / q.size, 0, 1))
    drift, moving = place_of(problem, "torque_drift", 1), problem.observed.moving
    solution = fitted(problem, (drift,), noise)
    left, bare = (problem.left(fitted(problem, some, noise).fitted) for some in ((drift,), ()))
    expected = np.sqrt((rmse(bare, moving) / rmse(left, moving)) ** 2 - 1.0)[0]
    assert error_removed(solution, drift) == pytest.approx(expected, rel=1e-6)
    assert surely_helps(solution, drift)


def test_what_rows_held_out_miss_at_any_of_its_joints_they_cannot_deny(sprung, monkeypatch):
    problem, noise = sprung
    absent = place_of(problem, "payload", 7)
    solution = fitted(problem, (absent,), noise)
    assert not surely_helps(solution, absent)
    monkeypatch.setattr(contribution, "_misses", lambda *_: np.arange(7) == 2)
    assert surely_helps(solution, absent)


def test_an_effect_acts_at_its_joints_and_a_body_at_all(sprung):
    problem, _ = sprung
    assert own_joints(problem, place_of(problem, "spring_load", 3)) == [2]
    assert own_joints(problem, place_of(problem, "payload", 7)) == list(range(7))


def test_what_it_does_elsewhere_by_what_is_beside_it_does_not_count(sprung):
    """A member of another joint moves the tolerances that all joints share."""
    problem, noise = sprung
    other = place_of(problem, "torque_offset", 6)
    alone = fitted(problem, (other,), noise)
    assert error_removed(alone, other) < 0.5


@pytest.mark.parametrize(("drag", "named"), [(0.0, True), (5.0, False)])
def test_what_is_small_beside_a_large_effect_may_be_imprecision_of_that(arm, drag, named):
    there = (QuadraticDrag(joint=1, coefficient=drag), TorqueOffset(joint=1, offset=0.1))
    problem = RegressionProblem.of(observed(*there, robot=str(arm)), quiet)
    noise = Noise.independent(np.full(2, 0.02), problem.split.fitted)
    own = place_of(problem, "torque_offset", 1)
    beside = [place_of(problem, "quadratic_drag", 1)] if drag else []
    solution = fitted(problem, tuple(sorted((own, *beside))), noise)
    assert 0.5 < error_removed(solution, own) < 1.0
    assert convincing(solution, own) == named


@pytest.mark.parametrize(
    ("of_sensors", "less", "strained"), [(0, 0, True), (0, 1, False), (4, 1, False)]
)
def test_several_stated_values_at_their_limits_strain_a_fit_and_sensors_do_not(
    of_sensors, less, strained
):
    entered = np.array([True] * 4 + [False] * 4)
    number = CONTRIBUTION.relieved - less
    limits = np.where(
        np.isin(np.arange(8), [*range(number), *range(4, 4 + of_sensors)]), 1.0, np.nan
    )
    nuisance = SimpleNamespace(prior=SimpleNamespace(index=entered), entered=entered)
    search = SimpleNamespace(evidence=SimpleNamespace(at_limit=lambda fit: fit))
    problem = SimpleNamespace(nuisance=nuisance)
    some = SimpleNamespace(problem=problem, search=search, fitted=np.full(8, np.nan))
    assert puts_values_at_limits(some, limits) is strained


@pytest.mark.parametrize(("square", "less"), [(0.0070, True), (0.0058, False)])
def test_joints_count_in_squares_of_their_own_errors(square, less):
    """Of 0.1 N m at the first, of 1 N m at the second, and of nothing where nothing is left."""
    left, bare = np.array([[0.0, 0.8, 0.0]]), np.array([[np.sqrt(square), 0.0, 0.0]])
    recordings, slow = [SimpleNamespace(duration=60.0)], SimpleNamespace(time=np.zeros(1))
    observed = SimpleNamespace(recordings=recordings, recording=np.zeros(1, dtype=int), slow=slow)
    scale, rows = np.array([0.1, 1.0, 0.0]), np.ones((1, 3), dtype=bool)
    assert surely_less(left, bare, scale, observed, rows) is less
