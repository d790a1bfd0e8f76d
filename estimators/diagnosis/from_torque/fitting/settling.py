"""Settling: prune, refine and simplify the set that was found, and search again around it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    TINY,
    changes_only_sign_width,
    error_removed,
    keeps_values_off_limits,
    own_coefficients,
    surely_helps,
    without,
)
from estimators.diagnosis.from_torque.fitting.laws import Setting, confused, likeliest, replaced
from estimators.diagnosis.from_torque.fitting.problem import (
    RegressionProblem,
    Solution,
    fitted,
    impossible,
    simulated,
)
from estimators.diagnosis.from_torque.fitting.simplicity import loaded, simplified
from estimators.diagnosis.from_torque.fitting.solving import solve
from estimators.diagnosis.from_torque.hypotheses.search import is_friction
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings import SOME
from estimators.diagnosis.settings.fitting import CONTRIBUTION, SOLVING
from estimators.regression.definite import ranked
from estimators.regression.evidence import REACH, joined, posterior
from limo_driver.physics.effect import MotionEffect

if TYPE_CHECKING:
    from collections.abc import Collection

    from estimators.diagnosis.stages import Progress
    from limo_driver.types import BoolArray, FloatArray


def pruned(solution: Solution) -> Solution:
    """Take out members that matter little or harm: precise, perhaps, but not physics to name.

    First those that cannot be as they are fitted: a competitor out of range ends no diagnosis.
    """
    while refused := impossible(solution):
        solution = _less(solution, refused)
    while (runaway := _runaway(solution)) is not None:
        solution = _less(solution, (runaway,))
    # what one joint lacks, bodies fit in part at all
    everywhere = range(solution.problem.observed.n)
    while idle := [member for member in solution.members if not _helps(solution, member)]:
        size = {member: error_removed(solution, member, everywhere) for member in idle}
        solution = _less(solution, (min(idle, key=lambda member: size[member]),))
    return solution


def _helps(solution: Solution, member: int) -> bool:
    """Say whether a member lowers errors: much, and whichever blocks of time had been recorded.

    Every joint rubs, and which law of friction it follows is a choice that has to be made: for the
    likelier law either will do, where it is felt at all: some sensors see no friction. Whether a
    member is a finding is another question.
    """
    if _relieves_sensors(solution, member) or keeps_values_off_limits(solution, member):
        return True
    everywhere = range(solution.problem.observed.n)
    size = error_removed(solution, member, everywhere)
    if is_friction(solution.problem.candidates[member].effect) and size >= CONTRIBUTION.felt:
        return size >= CONTRIBUTION.material or surely_helps(solution, member, everywhere)
    return size >= CONTRIBUTION.material and surely_helps(solution, member, everywhere)


def _relieves_sensors(solution: Solution, member: int) -> bool:
    """Say whether sensors would have to add as much as they may without a member.

    What they add is in no simulation, which then errs by it: so much, at least, as is worth naming.
    """
    problem = solution.problem
    of_sensors = ~problem.nuisance.entered
    fits = solution.fitted, without(solution, member)
    ahead, behind = (
        ~np.isnan(solution.search.evidence.at_limit(fit)[: of_sensors.size]) & of_sensors
        for fit in fits
    )
    if not (behind & ~ahead).any():
        return False
    left, bare = (rmse(problem.left_without_sensors(fit), problem.observed.moving) for fit in fits)
    return bool((bare**2 - left**2 >= CONTRIBUTION.material**2 * left**2).any())


def _runaway(solution: Solution) -> int | None:
    """Return the member to blame where a simulation errs more than the given one; else None.

    A fit is linear in what it adds. The simulation need not follow it: a joint that is so soft that
    it turns by a radian under its load carries everything beyond it along. To blame is what takes
    most of the deviation with it, all else as it is fitted: what is added as it stands, such as an
    offset, is not. Of two that deviate together, the one that is missed least. Nor is one without
    which the simulation errs more: friction by load deviates with a payload, which is no runaway.
    Where none is to blame by itself, a search around the set mends it.
    """
    if not solution.members:
        return None
    left = simulated(solution)
    if not _errs_too_much(solution, left):
        return None
    most = 0.5 * _deviation(solution, solution, left)
    gain = {
        member: _less(solution, (member,)).gain
        for member in solution.members
        if _deviation_without(solution, member) < most
    }
    errs = _in_errors(solution, left)
    for member in ranked(gain, gain.__getitem__):
        fewer = simulated(_less(solution, (member,)))
        if _in_errors(solution, fewer) < errs:
            return member
    return None


def _in_errors(whole: Solution, torque: FloatArray) -> float:
    """Return how large torques (K, n) are [errors that a fit leaves], joints summed up."""
    rows = whole.problem.split.fitted
    scale = np.maximum(rmse(whole.problem.left(whole.fitted), rows), TINY)
    return float(np.sum((rmse(torque, rows) / scale) ** 2))


def _errs_too_much(solution: Solution, left: FloatArray) -> bool:
    """Say whether the simulation of a fit errs more at some joint than it may.

    It may err as the given one does, or somewhat more than the fit says.
    """
    problem = solution.problem
    rows = problem.split.fitted
    given = np.maximum(rmse(problem.observed.residual, rows), TINY)
    linear = rmse(problem.left(solution.fitted), rows)
    return bool((rmse(left, rows) > np.maximum(given, 2 * linear)).any())


def _deviation(whole: Solution, solution: Solution, left: FloatArray) -> float:
    """Return how far a simulation is from its fit [errors that the whole set leaves, summed up].

    Args:
        whole: The set that the errors are of.
        solution: The fit.
        left: What the simulation of it leaves, (K, n) [N m].
    """
    fit = solution.fitted
    return _in_errors(whole, left - whole.problem.left(fit) - whole.problem.sensed(fit))


def _deviation_without(solution: Solution, member: int) -> float:
    """Return the deviation of a fit with a member at zero, and the others as they are."""
    mean = solution.fitted.mean.copy()
    mean[own_coefficients(solution, member)] = 0.0
    bare = replace(solution, fitted=replace(solution.fitted, mean=mean))
    return _deviation(solution, bare, simulated(bare))


def _less(solution: Solution, some: Collection[int]) -> Solution:
    """Return a solution without some of its members, fitted again."""
    return solution.having(solution.problem.less(solution.members, some))


def refined(solution: Solution, progress: Progress) -> Solution:
    """Refine what is not linear in every member, one after the other.

    What is confused with a member is refined beside it, and takes its place where that makes it
    likelier: which of them is best on a grid of settings may be no more than the grid's chance.
    The problem of what is returned has the refined candidates.
    """
    problem = solution.problem
    members, candidates = list(solution.members), list(problem.candidates)
    for place, member in enumerate(members):
        progress("refining parameters", 0.65 + 0.1 * place / len(members))
        candidate = candidates[member]
        if candidate.hypothesis is None:
            continue
        others = joined(*(candidates[m].prior for m in members if m != member))
        around = Setting(problem, others, solution.noise)
        most = -np.inf
        for other in (member, *confused(solution, member)):
            best = likeliest(solution, member, other, around)
            candidates[other] = candidate = replace(candidates[other], laws=best.laws)
            at = other
            if best.hypothesis is not candidate.hypothesis:
                new = replaced(candidate, best.hypothesis, around)
                if new is None:
                    continue
                candidates.append(new)
                at = len(candidates) - 1
            if best.evidence > most:
                most, members[place] = best.evidence, at
    more = len(candidates) > len(problem.candidates)
    problem = problem.with_candidates(candidates)
    if not more:
        return replace(solution, problem=problem)
    return fitted(problem, tuple(members), solution.noise)


def prune_refine_simplify(solution: Solution, progress: Progress) -> Solution:
    """Prune, refine and simplify a set; its problem then has the candidates that it needs.

    Where that has impacts which were not recorded, another is sought without their play.
    """
    solution = simplified(pruned(refined(pruned(solution), progress)))
    solution = pruned(loaded(_of_one_width(solution, progress)))
    if not (silent := _not_recorded(solution)):
        return solution
    return prune_refine_simplify(solve(solution.problem.without_places(silent), progress), progress)


def _not_recorded(solution: Solution) -> set[tuple[str, tuple[int, ...]]]:
    """Return the members whose impacts were not recorded, as effects and joints (0-based).

    What is sharper than the filter is compared behind it, where a law of impacts bends to much that
    is slow. What its impacts have above the filter's bandwidth was recorded there, beside noise.
    Where less was, since the drive recoils, an impact still goes the way of its law, and is as
    sharp; or there was none.
    """
    fit, found = solution.problem.under(solution), set[tuple[str, tuple[int, ...]]]()
    sharp = [
        effect
        for effect in fit.simulation.effects
        if isinstance(effect, MotionEffect) and effect.displaces and effect.agility > 1.0
    ]
    whole = fit.predict(fit.simulation) if sharp else fit.recorded
    for effect in sharp:
        others = tuple(other for other in fit.simulation.effects if other is not effect)
        bare = fit.predict(replace(fit.simulation, effects=others))
        own = [j - 1 for j in effect.joints]
        of_law, recorded = (
            np.nan_to_num(fit.above(torque[:, own])[:, 0])
            for torque in (whole - bare, fit.recorded - bare)
        )
        periods = (fit.motion.time * fit.bandwidth).astype(np.int64)
        starts = np.flatnonzero(np.diff(periods, prepend=periods[0] - 1))
        impact, highest = (np.maximum.reduceat(np.abs(x), starts) for x in (of_law, recorded))
        agrees = np.add.reduceat(of_law * recorded, starts) > 0
        stands_out = impact > 2.0 * np.median(highest)
        seen = agrees & (highest >= impact)
        few = np.sum(seen[stands_out]) < SOME * np.sum(stands_out)
        if few and np.sum(of_law**2) > np.sum(recorded**2):
            found.add((effect.name, tuple(own)))
    return found & {solution.problem.candidates[member].place for member in solution.members}


def _of_one_width(solution: Solution, progress: Progress) -> Solution:
    """Return a solution without stated friction over another width that found friction can have.

    Where friction along the range is found beside stated friction that is sharper, one takes from
    the other what it adds, and the widths of both were sought with the other there. So the rest is
    refined without the sharper one, which stays if it fits what the rest cannot. How well either
    foretells positions that only one block of time passed is chance, and says nothing of that.
    """
    for member in solution.members:
        candidates = solution.problem.candidates
        if not candidates[member].other_width:
            continue
        rest = tuple(other for other in solution.members if other != member)
        beside = [other for other in rest if candidates[other].joints == candidates[member].joints]
        if not any(
            candidates[other].kind == "missing" and is_friction(candidates[other].effect)
            for other in beside
        ):
            continue
        bare = refined(fitted(solution.problem, rest, solution.noise), progress)
        less = bare.problem
        again = fitted(less, (*bare.members, member), solution.noise)
        left, lacking = (rmse(less.left(one.fitted), less.split.fitted) for one in (again, bare))
        if (lacking**2 - left**2 < CONTRIBUTION.material**2 * left**2).all():
            solution = bare
    return solution


def solve_around(solution: Solution, progress: Progress) -> Solution:
    """Search again around a set, and settle the one that is found there.

    A gain acts on the friction that was found beside it, too, and an offset of an encoder on the
    load of a heavier link. Around the given simulation, what such a pair makes of one another looks
    like one effect more, or hides one.
    """
    problem, near = relinearised(solution, progress)
    return prune_refine_simplify(solve(problem, progress, near), progress)


def suspects(solution: Solution, joints: Collection[int]) -> set[tuple[str, tuple[int, ...]]]:
    """Return the effects of which a fit has a value at its limit, and which may be wrong by it.

    At some joints (0-based) any of them; anywhere those whose value surely lies beyond its limit.
    None is of friction that is but sharper: there, a limit is no value that friction has.
    """
    problem = solution.problem
    limited = ~np.isnan(solution.search.evidence.at_limit(solution.fitted))
    if not limited.any():
        return set()
    turned = {
        problem.candidates[member].place
        for member in solution.members
        if changes_only_sign_width(solution, member)
    }
    limited &= ~problem.nuisance.of(turned)
    far = limited & _surely_beyond(solution, limited)
    return {
        item.place
        for item, limit, beyond in zip(problem.nuisance.parameters, limited, far, strict=True)
        if item.of_effect
        and limit
        and (beyond or not item.place[1] or set(item.place[1]) & set(joints))
    }


def _surely_beyond(solution: Solution, some: BoolArray) -> BoolArray:
    """Mark those of some nuisance coefficients (c,) that data put surely beyond their limits."""
    nuisance, search = solution.problem.nuisance.prior, solution.search
    free = np.where(some, SOLVING.unbound * nuisance.deviation, nuisance.deviation)
    fit = posterior(
        search.evidence.products, replace(nuisance, deviation=free), search.prior(solution.members)
    )
    count = nuisance.index.size
    off, sure = fit.mean[:count], fit.deviation[:count]
    return np.abs(off) - REACH * sure > REACH * nuisance.deviation


def linearisation_is_poor(solution: Solution) -> bool:
    """Say whether a solution's simulation leaves clearly more or less than its linear fit says."""
    linear = solution.problem.left_without_sensors(solution.fitted)
    moving = solution.problem.observed.moving
    off, rest = rmse(simulated(solution) - linear, moving), rmse(linear, moving)
    return bool((off > SOLVING.linearisation_is_poor * rest).any())


def relinearised(
    solution: Solution, progress: Progress
) -> tuple[RegressionProblem, tuple[int, ...]]:
    """Lay everything out again, with columns around the simulation of a solution.

    They hold near it, so that a set without what it has would be judged wrongly: beside a friction
    that is in, the gain of a sensor looks as that friction does.

    Returns:
        The problem, and the members of the solution on it.
    """
    problem = solution.problem
    improved = problem.under(solution).simulation
    new = RegressionProblem.of(
        problem.observed.under(problem.observed.simulation, around=improved), progress
    )
    new = new.as_stated(problem.nuisance.prior.deviation == 0)
    observed, mean = new.observed, solution.fitted.mean
    index = new.nuisance.prior.index
    torque = new.columns.apply(index, np.where(new.nuisance.entered, mean[: index.size], 0.0))
    members = tuple(new.again(problem.candidates[member], member) for member in solution.members)
    own = joined(*(new.candidates[member].prior for member in members)).index
    torque += new.columns.apply(own, mean[index.size :])
    left = observed.measured - observed.filter(observed.predicted)
    return replace(new, target=left + torque, first=problem.first or problem), members
