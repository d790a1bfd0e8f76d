"""Blocks held out in turn: each is predicted from the others, and nearly all rows can judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noisy_recordings import observed

from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, fitted
from estimators.diagnosis.from_torque.residuals.noise import Noise
from estimators.diagnosis.held_out import Split
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.diagnosis.stages import quiet
from limo_driver.physics import SpringLoad


@pytest.fixture(scope="module")
def sprung():
    problem = RegressionProblem.of(observed(SpringLoad(joint=3, stiffness=2.0, rest=0.3)), quiet)
    noise = Noise.independent(np.full(7, 0.02), problem.split.fitted)
    places = [candidate.place for candidate in problem.candidates]
    return problem, fitted(problem, (places.index(("spring_load", (2,))),), noise)


def rotation_and_residual(problem, solution):
    rotation = problem.rotation(solution.noise, solution.members)
    return rotation, rotation.left(solution.search.prior(solution.members))


def test_every_block_but_the_first_and_last_is_held_out_once(sprung):
    problem, solution = sprung
    rotation, _ = rotation_and_residual(problem, solution)
    turns = np.sum([split.held_out for split in rotation.splits], axis=0)
    time, moving = problem.observed.slow.time, problem.observed.moving
    edges = np.linspace(time[0], time[-1], HELD_OUT.blocks + 1)
    inner = (time >= edges[1]) & (time < edges[-2])
    assert (turns[inner] == moving[inner]).all()
    assert not turns[~inner].any()


def test_rows_are_predicted_by_a_fit_to_the_others(sprung):
    problem, solution = sprung
    _, left = rotation_and_residual(problem, solution)
    rows = Split.of(problem.observed).held_out  # one of the turns, and the fit is to the same rows
    assert left[rows] == pytest.approx(problem.left(solution.fitted)[rows], abs=1e-6)


def test_sums_are_kept_for_sets_of_the_same_members(sprung):
    problem, solution = sprung
    rotation, _ = rotation_and_residual(problem, solution)
    assert problem.rotation(solution.noise, ()) is rotation
    assert problem.rotation(solution.noise.larger(np.full(7, 2.0)), ()) is not rotation


def test_of_another_residual_sums_are_others(sprung):
    problem, solution = sprung
    rotation, _ = rotation_and_residual(problem, solution)
    other = replace(problem, target=0.5 * problem.target)
    assert other.rotation(solution.noise, solution.members) is not rotation
    assert problem.with_candidates(problem.candidates).rotation(solution.noise, ()) is rotation


def test_the_simulation_of_a_fit_is_kept_until_another_is_asked_for(sprung):
    problem, solution = sprung
    beside = problem.under(solution)
    assert problem.under(solution) is beside
    bare = problem.under(solution.having(()))
    assert np.abs(bare.residual - beside.residual)[:, 2].max() > 1.0  # [N m], without the spring
    again = problem.under(solution)
    assert again is not beside
    np.testing.assert_array_equal(again.residual, beside.residual)
