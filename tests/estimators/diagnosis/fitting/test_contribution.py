"""What a member removes counts where it acts, and only if another day would have shown it, too."""

from __future__ import annotations

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.fitting.contribution import convincing, material, own_joints
from estimators.diagnosis.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.residuals.noise import Noise
from estimators.diagnosis.stages import quiet
from limo_driver.physics import QuadraticDrag, SpringLoad, TorqueOffset


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
    assert material(problem, solution, spring) > 3.0
    assert material(problem, solution, absent) == 0.0


def test_an_effect_acts_at_its_joints_and_a_body_at_all(sprung):
    problem, _ = sprung
    assert own_joints(problem, place_of(problem, "spring_load", 3)) == [2]
    assert own_joints(problem, place_of(problem, "payload", 7)) == list(range(7))


def test_what_it_does_elsewhere_by_what_is_beside_it_does_not_count(sprung):
    """A member of another joint moves the tolerances that all joints share."""
    problem, noise = sprung
    other = place_of(problem, "torque_offset", 6)
    alone = fitted(problem, (other,), noise)
    assert material(problem, alone, other) < 0.5


@pytest.mark.slow("fits an arm of seven joints each")
@pytest.mark.parametrize(("drag", "named"), [(0.0, True), (5.0, False)])
def test_what_is_small_beside_a_large_effect_may_be_imprecision_of_that(drag, named):
    there = (QuadraticDrag(joint=3, coefficient=drag), TorqueOffset(joint=3, offset=0.022))
    problem = RegressionProblem.of(observed(*there), quiet)
    noise = Noise.independent(np.full(7, 0.02), problem.split.fitted)
    own = place_of(problem, "torque_offset", 3)
    beside = [place_of(problem, "quadratic_drag", 3)] if drag else []
    solution = fitted(problem, tuple(sorted((own, *beside))), noise)
    assert 0.5 < material(problem, solution, own) < 1.0
    assert convincing(problem, solution, own) == named
