"""Contribution: the held-out error that each member of a set removes, and its least size.

Widths: over which speeds stated dry friction turns its sign is guessed, and its size is known.

A change of friction may act over another width than is stated. Beside what tolerances allow, that
is also how a fit says that all of it is sharper: less of it over the stated width, and as much more
over the other. Only their sum tells whether there is more friction than there may be.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.problem import fitted
from estimators.diagnosis.headline import is_of_bodies
from estimators.diagnosis.held_out import rmse, surely_positive
from estimators.diagnosis.settings import MATTERS, ROUNDING, TINY
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from estimators.diagnosis.settings.judgement import JUDGEMENT
from estimators.regression.evidence import REACH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.regression.evidence import Posterior
    from limo_driver.types import BoolArray, FloatArray


def without(solution: Solution, member: int) -> Posterior:
    """Fit the set without one of its members."""
    return solution.having(solution.problem.less(solution.members, (member,))).fitted


def coefficients(solution: Solution, member: int) -> FloatArray:
    """Return the fitted coefficients (c,) of a member of a set."""
    return solution.fitted.mean[own_coefficients(solution, member)]


def own_coefficients(solution: Solution, member: int) -> slice:
    """Return where the coefficients of a member of a set stand among all that are fitted."""
    at = solution.problem.nuisance.prior.index.size
    for i in solution.members:
        size = solution.problem.candidates[i].prior.index.size
        if i == member:
            return slice(at, at + size)
        at += size
    raise KeyError(member)


def left_by_tolerances(solution: Solution) -> FloatArray:
    """Return the residual (K, n) of values moved within their tolerances, and of no effect [N m].

    Joints of which the simulation states no friction have Coulomb and viscous friction.
    """
    first, base = _of_base(solution)
    return first.left(base.fitted)


def left_by_base(solution: Solution) -> FloatArray:
    """Return the same of a simulation, which has nothing of what sensors add [N m]."""
    first, base = _of_base(solution)
    return first.left_without_sensors(base.fitted)


def _of_base(solution: Solution) -> tuple[RegressionProblem, Solution]:
    problem = solution.problem
    first = problem.first or problem  # columns around what was found say nothing of a set without
    if first is not problem:
        solution = fitted(first, (), solution.noise)
    return first, solution.having(first.base)


def own_joints(problem: RegressionProblem, member: int) -> list[int]:
    """Return the joints (0-based) on which a member acts.

    Without it, what is fitted beside it would change elsewhere, too.
    """
    candidate = problem.candidates[member]
    everywhere = is_of_bodies(candidate.effect) or not candidate.joints
    return list(range(problem.observed.n) if everywhere else candidate.joints)


def contribution(solution: Solution, member: int) -> FloatArray:
    """Return the held-out mean square that a member removes at each joint, (n,) [N² m²]."""
    problem = solution.problem
    left, bare = problem.left(solution.fitted), problem.left(without(solution, member))
    return taken_off(left, bare, problem.split.held_out)


def contribution_of_all(solution: Solution) -> FloatArray:
    """Return the held-out mean square that a set removes beyond its base, (n,) [N² m²]."""
    problem = solution.problem
    base = solution.search.evidence.posterior(solution.search.prior(problem.base))
    left = problem.left(solution.fitted)
    return taken_off(left, problem.left(base), problem.split.held_out)


def taken_off(left: FloatArray, bare: FloatArray, rows: BoolArray) -> FloatArray:
    """Return by how much the mean square of one residual is below another's, (n,) [N² m²]."""
    return rmse(bare, rows) ** 2 - rmse(left, rows) ** 2


def error_removed(solution: Solution, member: int, joints: Sequence[int] | None = None) -> float:
    """Return the error that a member removes at the joint where it does most [errors left].

    Counted on rows held out, each block in turn: a few blocks may hold but one reversal. What fades
    within the first minute, or happens but now and then, may miss most of those: then over all
    rows, but nothing where it makes those held out clearly worse.

    Args:
        solution: The set.
        member: Of it.
        joints: That count (0-based); by default those that it acts on.
    """
    problem = solution.problem
    less = problem.less(solution.members, (member,))
    (ahead, behind), rows = in_turn(solution, solution.members, less)
    left, bare = problem.left(solution.fitted), problem.left(without(solution, member))
    moving = problem.observed.moving
    gained, proven = taken_off(left, bare, moving), taken_off(ahead, behind, rows)
    shown = proven >= -MATTERS * gained
    part = np.where(
        _misses(left, bare, rows, moving),
        shown * gained / _square(left, moving),
        proven / _square(ahead, rows),
    )
    counted = own_joints(problem, member) if joints is None else list(joints)
    return float(np.sqrt(max(part[counted].max(), 0.0)))


def surely_helps(solution: Solution, member: int, joints: Sequence[int] | None = None) -> bool:
    """Say whether a member lowers errors of some joints, whichever blocks had been recorded.

    Nor may those get worse that are held out for good, and that a report shows. Of what misses most
    of the rows that are held out, those cannot say.

    Args:
        solution: The set.
        member: Of it.
        joints: That count (0-based), together; by default those that it acts on.
    """
    problem = solution.problem
    if acts_seldom(solution, member):
        return True
    left, bare = problem.left(solution.fitted), problem.left(without(solution, member))
    counted = own_joints(problem, member) if joints is None else list(joints)
    less, shown = problem.less(solution.members, (member,)), problem.split.held_out
    gained = np.sum((taken_off(left, bare, shown) / _square(left, shown))[counted])
    if gained <= ROUNDING:
        return False
    return surely_better(solution, solution.members, less, counted)


def acts_seldom(solution: Solution, member: int) -> bool:
    """Say whether a member acts so seldom that rows held out in turn miss most of it."""
    problem = solution.problem
    less = problem.less(solution.members, (member,))
    left, bare = problem.left(solution.fitted), problem.left(without(solution, member))
    rows = problem.rotation(solution.noise, (*solution.members, *less)).held_out
    missed = _misses(left, bare, rows, problem.observed.moving)
    return bool(missed[own_joints(problem, member)].any())


def keeps_values_off_limits(solution: Solution, member: int) -> bool:
    """Say whether several stated values would have to be as far off as they may without a member.

    Few rows show little more error then, since those values stand in for it. But that several are
    so far off at once is far less likely than the member.
    """
    return puts_values_at_limits(solution, without(solution, member))


def puts_values_at_limits(solution: Solution, other: Posterior) -> bool:
    """Say whether another fit has several more stated values as far off as they may be.

    Args:
        solution: This.
        other: Fit of another set.
    """
    count = solution.problem.nuisance.prior.index.size
    ahead, behind = (
        ~np.isnan(solution.search.evidence.at_limit(fit)[:count])
        & solution.problem.nuisance.entered
        for fit in (solution.fitted, other)
    )
    return int(behind.sum()) - int(ahead.sum()) >= CONTRIBUTION.relieved


def convincing(solution: Solution, member: int) -> bool:
    """Say whether a member removes enough error where it acts, and surely so, to be a finding.

    What is small, and next to nothing of what the set explains there, is imprecision of the others.
    """
    if keeps_values_off_limits(solution, member):
        return True
    size = error_removed(solution, member)
    if size < CONTRIBUTION.material or not surely_helps(solution, member):
        return False
    if size >= 1.0:
        return True
    least = (1.0 - JUDGEMENT.precise) * contribution_of_all(solution)
    own = own_joints(solution.problem, member)
    return bool((contribution(solution, member) >= least)[own].any())


def surely_better(
    solution: Solution, ahead: tuple[int, ...], behind: tuple[int, ...], joints: Sequence[int]
) -> bool:
    """Say whether one set surely predicts rows of some joints (0-based) better than another.

    Each block is held out in turn, and whichever of them had been recorded.
    """
    (left, bare), rows = in_turn(solution, ahead, behind)
    left, bare, rows = left[:, joints], bare[:, joints], rows[:, joints]
    return surely_less(left, bare, rmse(left, rows), solution.problem.observed, rows)


def surely_less(
    left: FloatArray, bare: FloatArray, scale: FloatArray, observed: Observations, rows: BoolArray
) -> bool:
    """Say whether one residual is surely smaller than another, whichever blocks were recorded.

    Args:
        left: The one, (K, n) [N m].
        bare: The other.
        scale: In which those of each joint are counted, (n,) [N m].
        observed: Where time comes from.
        rows: That count, (K, n).
    """
    gained = (bare**2 - left**2) / np.maximum(scale, TINY) ** 2
    return surely_positive(gained, observed, rows)


def in_turn(solution: Solution, *sets: tuple[int, ...]) -> tuple[list[FloatArray], BoolArray]:
    """Return what sets leave (K, n) where each block is held out once [N m], and those rows."""
    rotation = solution.problem.rotation(
        solution.noise, [member for some in sets for member in some]
    )
    return [rotation.left(solution.search.prior(some)) for some in sets], rotation.held_out


def _misses(
    left: FloatArray, bare: FloatArray, held_out: BoolArray, moving: BoolArray
) -> BoolArray:
    """Mark the joints (n,) on which rows held out have little of what a member adds."""
    added = bare - left
    return np.asarray(rmse(added, held_out) ** 2 < 0.5 * rmse(added, moving) ** 2)


def _square(left: FloatArray, rows: BoolArray) -> FloatArray:
    return np.maximum(rmse(left, rows) ** 2, TINY**2)


def changes_only_sign_width(solution: Solution, member: int) -> bool:
    """Say whether a member makes stated friction sharper or softer, of a size that it may have."""
    problem = solution.problem
    candidate = problem.candidates[member]
    if not candidate.other_width:
        return False
    sizes = problem.nuisance.of([candidate.place])
    # of the given simulation: here, values may be held as they are stated
    deviation = (problem.first or problem).nuisance.prior.deviation[sizes]
    return bool((np.abs(change_of(solution, member)) <= REACH * deviation).all())


def change_of(solution: Solution, member: int) -> FloatArray:
    """Return by which part of it each size of a stated effect changes, (c,).

    That is what its tolerance takes of the change, and what the member adds.
    """
    sizes = solution.problem.nuisance.of([solution.problem.candidates[member].place])
    within = solution.fitted.mean[: sizes.size][sizes]
    return within + coefficients(solution, member)
