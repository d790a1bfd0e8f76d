"""Contribution: the held-out error that each member of a set removes, and its least size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.problem import fitted
from estimators.diagnosis.residuals.held_out import rmse, surely_positive
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.wording import is_of_bodies

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.fitting.problem import RegressionProblem, Solution
    from estimators.regression.evidence import Posterior
    from limo_driver.types import FloatArray

TINY = 1e-12  # [N m], that nothing is divided by less than


def without(problem: RegressionProblem, solution: Solution, member: int) -> Posterior:
    """Fit the set without one of its members."""
    return solution.having(problem.less(solution.members, (member,))).fitted


def coefficients(problem: RegressionProblem, solution: Solution, member: int) -> FloatArray:
    """Return the fitted coefficients (c,) of a member of a set."""
    at = problem.nuisance.prior.index.size
    for i in solution.members:
        size = problem.candidates[i].prior.index.size
        if i == member:
            return solution.fitted.mean[at : at + size]
        at += size
    raise KeyError(member)


def left_by_tolerances(problem: RegressionProblem, solution: Solution) -> FloatArray:
    """Return the residual (K, n) of values moved within their tolerances, and of no effect [N m].

    Joints of which the simulation states no friction have Coulomb and viscous friction.
    """
    first = problem.first or problem  # columns around what was found say nothing of a set without
    if first is not problem:
        solution = fitted(first, (), solution.noise)
    return first.left(solution.having(first.base).fitted)


def own_joints(problem: RegressionProblem, member: int) -> list[int]:
    """Return the joints (0-based) on which a member acts.

    Without it, what is fitted beside it would change elsewhere, too.
    """
    candidate = problem.candidates[member]
    everywhere = is_of_bodies(candidate.effect) or not candidate.joints
    return list(range(problem.observed.n) if everywhere else candidate.joints)


def contribution(problem: RegressionProblem, solution: Solution, member: int) -> FloatArray:
    """Return the held-out mean square that a member removes at each joint, (n,) [N² m²]."""
    left, bare = problem.left(solution.fitted), problem.left(without(problem, solution, member))
    return taken_off(left, bare, problem.split.held_out)


def taken_off(left: FloatArray, bare: FloatArray, rows: NDArray[np.bool_]) -> FloatArray:
    """Return by how much the mean square of one residual is below another's, (n,) [N² m²]."""
    return rmse(bare, rows) ** 2 - rmse(left, rows) ** 2


def material(problem: RegressionProblem, solution: Solution, member: int) -> float:
    """Return the error that a member removes at the joint where it does most [errors left].

    Of the joints that it acts on, and counted on rows held out; 0 where that sum might as well be
    negative, had other blocks of time been recorded. What fades within the first minute, or happens
    but now and then, may miss most of those: then over all rows, but nothing where it makes those
    held out clearly worse.
    """
    left, bare = problem.left(solution.fitted), problem.left(without(problem, solution, member))
    moving, held_out = problem.observed.moving, problem.split.held_out
    gained, proven = taken_off(left, bare, moving), taken_off(left, bare, held_out)
    misses = rmse(bare - left, held_out) ** 2 < CONTRIBUTION.seen * rmse(bare - left, moving) ** 2
    part = np.where(
        misses & (proven >= -CONTRIBUTION.slight * gained), gained / _square(left, moving), 0.0
    )
    part = np.where(misses, part, proven / _square(left, held_out))
    own = own_joints(problem, member)
    if not misses[own].any():
        scaled = ((bare**2 - left**2) / _square(left, held_out))[:, own]
        if not surely_positive(scaled, problem.observed, held_out[:, own]):
            return 0.0
    return float(np.sqrt(max(part[own].max(), 0.0)))


def _square(left: FloatArray, rows: NDArray[np.bool_]) -> FloatArray:
    return np.maximum(rmse(left, rows) ** 2, TINY**2)
