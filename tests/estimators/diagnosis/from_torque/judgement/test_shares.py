"""Shares: parts of what tolerances leave that add up, however effects overlap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.fitting.contribution import contribution, left_by_tolerances
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.judgement.findings import left_at, shares_of
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.held_out import reducible_removed, rmse
from estimators.diagnosis.stages import quiet
from limo_driver.physics import CoulombFriction, SpringLoad
from limo_driver.recordings.recording import Recording

FLOOR = np.full(2, 0.01)  # [N m]


@pytest.fixture(scope="module")
def problem(rigid, training_recording):
    """An arm with a spring that its simulation lacks, and Coulomb friction a little too low."""
    r = training_recording
    known = tuple(CoulombFriction(joint=j, tau_c=1.3) for j in (1, 2))
    true = replace(rigid, effects=(*known, SpringLoad(joint=2, stiffness=8.0, rest=0.0)))
    noise = FLOOR * np.random.default_rng(0).standard_normal(r.position.shape)
    recording = Recording.from_arrays(r.time, r.position, true.predict(r.motion(10.0)) + noise)
    return RegressionProblem.of(Observations.of(rigid, [recording], 10.0), quiet)


def members_of(problem, *places):
    return tuple(
        next(i for i, c in enumerate(problem.candidates) if c.place == place) for place in places
    )


def solved(problem, members):
    return fitted(problem, members, Noise.independent(FLOOR, problem.split.fitted))


def test_values_inside_tolerances_take_their_part_before_any_share(problem):
    (spring,) = members_of(problem, ("spring_load", (1,)))
    solution = solved(problem, (spring,))
    before = rmse(problem.observed.residual, problem.split.held_out)
    alone = rmse(left_by_tolerances(solution), problem.split.held_out)
    after = rmse(problem.left(solution.fitted), problem.split.held_out)
    assert alone[0] < 0.1 * before[0]  # the friction of joint 1 is inside its tolerance
    assert shares_of(solution, alone, after, FLOOR)[spring] == pytest.approx(1.0, abs=0.03)


def test_shares_of_effects_that_overlap_add_up_to_what_the_set_takes(problem):
    members = members_of(problem, ("spring_load", (1,)), ("torque_offset", (1,)))
    solution = solved(problem, members)
    alone = rmse(left_by_tolerances(solution), problem.split.held_out)
    after = 0.2 * alone
    shares = shares_of(solution, alone, after, FLOOR)
    taken = reducible_removed(alone, after, FLOOR)
    assert 0.9 < taken < 1.0
    assert sum(shares.values()) == pytest.approx(taken, rel=1e-9)
    parts = [max(contribution(solution, member).sum(), 0.0) for member in members]
    wanted = [taken * part / sum(parts) for part in parts]
    assert [shares[member] for member in members] == pytest.approx(wanted, rel=1e-9)


def test_what_predicts_worse_has_no_share(problem):
    members = members_of(problem, ("spring_load", (1,)))
    solution, nothing = solved(problem, members), np.array([0.3, 0.5])
    assert shares_of(solution, nothing, 1.1 * nothing, FLOOR) == {members[0]: 0.0}


def test_what_is_taken_and_what_stays_add_up():
    alone, after = np.array([0.3, 0.5]), np.array([0.1, 0.4])
    whole, own = left_at((1,), alone, after, FLOOR)
    assert own == pytest.approx(((0.4**2 - 1e-4) / (0.5**2 - 1e-4),))
    assert whole == pytest.approx((0.4**2 - 1e-4) / (0.3**2 + 0.5**2 - 2e-4))
    both, _ = left_at((0, 1), alone, after, FLOOR)
    taken = (0.3**2 + 0.5**2 - 0.1**2 - 0.4**2) / (0.3**2 + 0.5**2 - 2e-4)
    assert both + taken == pytest.approx(1.0)


def test_where_nothing_is_left_nothing_stays():
    assert left_at((0,), FLOOR, FLOOR, FLOOR) == (0.0, (0.0,))
