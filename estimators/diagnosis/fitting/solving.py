"""Solving: find the set of effects of most evidence, then fit, prune and refine it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.contribution import (
    TINY,
    material,
    own_coefficients,
    relieves,
    sure,
    without,
)
from estimators.diagnosis.fitting.lateness import has_long, long_after
from estimators.diagnosis.fitting.laws import confused, likeliest
from estimators.diagnosis.fitting.problem import (
    RegressionProblem,
    Solution,
    fitted,
    impossible,
    lost_by,
    search_on,
    simulated,
)
from estimators.diagnosis.fitting.refinement import Setting, replaced
from estimators.diagnosis.fitting.simplicity import loaded, simplified
from estimators.diagnosis.fitting.widths import merely_sharper
from estimators.diagnosis.hypotheses.ripple import ripples
from estimators.diagnosis.residuals.held_out import rmse
from estimators.diagnosis.residuals.noise import Noise, roughness
from estimators.diagnosis.selection.base_friction import rubs
from estimators.diagnosis.selection.candidates import entered
from estimators.diagnosis.settings.fitting import CONTRIBUTION, SOLVING
from estimators.diagnosis.wording import LINK_INERTIA
from estimators.regression.evidence import REACH, Prior, joined, posterior
from limo_driver.physics import TorqueRipple

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from numpy.typing import NDArray

    from estimators.diagnosis.stages import Progress
    from estimators.regression.evidence import Posterior
    from limo_driver.physics import Hypothesis
    from limo_driver.types import FloatArray


def solve(
    problem: RegressionProblem, progress: Progress, near: tuple[int, ...] | None = None
) -> tuple[RegressionProblem, Solution]:
    """Find the set of effects, or the best one near a set; noise and set in turn until both stay.

    The first noise is what a fit of everything at once leaves. Taken from a residual that still
    has an effect in it, the noise would explain that effect, and hide it.

    While sets compete, tolerances are the deviations of normal priors, which thousands of rows
    outvote; fitted values stay inside them. So once more with those of bodies held that a fit has
    at their limit: what they would have explained beyond may be an effect, or a body that is wrong.

    Returns:
        The problem with the candidates and limits of the solution, and that.
    """
    problem = problem.holding(None)
    noise = noise_of_everything(problem)
    if not any(has_long(candidate) for candidate in problem.candidates):
        problem = _with(problem, long_after(problem.observed.n))
    problem = _scanned(problem, fitted(problem, problem.base, noise))
    solution = _sought(problem, noise, progress, near)
    problem = _scanned(problem, solution)  # of what the largest effects hid
    solution = _until_it_stays(problem, solution, progress, near)
    limits = solution.search.evidence.at_limit(solution.fitted)
    limits[problem.observed.chain.width :] = np.nan  # bodies come first
    if not np.isnan(limits).all():
        limited = problem.holding(limits)
        more = _until_it_stays(limited, solution, progress, near)
        if set(more.members) != set(solution.members):
            problem, solution = limited, more
    problem, solution = _of_what_can_be(problem, solution, progress, near)
    return _of_links_that_can_be(problem, solution, progress, near)


def _of_links_that_can_be(
    problem: RegressionProblem, solution: Solution, progress: Progress, near: tuple[int, ...] | None
) -> tuple[RegressionProblem, Solution]:
    """Return a solution, or the best one without wrong links where its own cannot be what it says.

    Ten free parameters a link follow much that is no mass, such as the gains of two sensors, and
    evidence compares them as if they could be anything. Where the simulation, whose links are
    bodies, errs far more than the fit of them, that of other effects may be nearer.
    """
    links = {item.place for item in problem.candidates if item.effect == LINK_INERTIA}
    if not any(problem.candidates[member].place in links for member in solution.members):
        return problem, solution
    rows = problem.split.fitted
    linear = np.maximum(rmse(problem.left_without_sensors(solution.fitted), rows), TINY)
    own = rmse(simulated(problem, solution), rows)
    if not (own > SOLVING.followed * linear).any():
        return problem, solution
    fewer = problem.without_places(links)
    other = _until_it_stays(fewer, solution, progress, _elsewhere(problem, near, links))
    its = rmse(simulated(fewer, other), rows)
    nearer = np.sum((its / linear) ** 2) < np.sum((own / linear) ** 2)
    return (fewer, other) if nearer else (problem, solution)


def _of_what_can_be(
    problem: RegressionProblem, solution: Solution, progress: Progress, near: tuple[int, ...] | None
) -> tuple[RegressionProblem, Solution]:
    """Return a solution, or the best one without a body that would bring less within reach.

    Sets compete with any ten parameters for a body. One whose mass is where the arm is not may
    stand for what the set lacks.
    """
    while lost := lost_by(problem, solution):
        worst = max(lost, key=lambda member: lost[member])
        if lost[worst] < CONTRIBUTION.tellable:
            break
        places = {problem.candidates[worst].place}
        fewer = problem.without_places(places)
        near = _elsewhere(problem, near, places)
        other = _until_it_stays(fewer, solution, progress, near)
        if solution.search.gain(other.members) < solution.gain - lost[worst]:
            break
        problem, solution = fewer, other
    return problem, solution


def _elsewhere(
    problem: RegressionProblem,
    near: tuple[int, ...] | None,
    places: Collection[tuple[str, tuple[int, ...]]],
) -> tuple[int, ...] | None:
    """Return the members of a set that is searched around, if one is, at no such place."""
    if near is None:
        return None
    return tuple(i for i in near if problem.candidates[i].place not in places)


def _until_it_stays(
    problem: RegressionProblem, solution: Solution, progress: Progress, near: tuple[int, ...] | None
) -> Solution:
    for _ in range(SOLVING.rounds):
        before = set(solution.members)
        noise = noise_left(problem, solution.fitted)
        solution = _sought(problem, noise, progress, near)
        if set(solution.members) == before:
            break
    return solution


def _sought(
    problem: RegressionProblem, noise: Noise, progress: Progress, near: tuple[int, ...] | None
) -> Solution:
    progress("comparing explanations", 0.4)
    search = search_on(problem, noise)
    found = search.best() if near is None else search.around(near)
    posterior = search.evidence.posterior(search.prior(found.members))
    return Solution(found.members, search, noise, posterior, found.gain)


def _scanned(problem: RegressionProblem, solution: Solution) -> RegressionProblem:
    """Return the problem with the candidates that have to be looked for in the residual."""
    chosen = [problem.candidates[member].hypothesis for member in solution.members]
    known = {
        item.joints[0]: item.settings
        for item in chosen
        if item is not None and item.effect == TorqueRipple.name
    }
    return _with(problem, ripples(problem.observed, problem.left(solution.fitted), known))


def _with(problem: RegressionProblem, more: Iterable[Hypothesis]) -> RegressionProblem:
    """Return the problem with further hypotheses among what competes."""
    found = [entered(item, problem.observed, problem.columns, problem.level) for item in more]
    return problem.with_candidates([*problem.candidates, *filter(None, found)])


def noise_of_everything(problem: RegressionProblem) -> Noise:
    """Return the noise that a fit of all candidates at once leaves, by its degrees of freedom.

    Not of those that act as another does over another width: with few rows, columns that hardly
    differ explain noise, and chance gets a name.
    """
    white = Noise.independent(
        roughness(problem.target, problem.observed.moving, problem.observed.least_noise),
        problem.split.fitted,
    )
    evidence = search_on(problem, white).evidence
    everything = joined(*(item.prior for item in problem.candidates if not item.other_width))
    widest = np.argsort(-everything.deviation, kind="stable")  # of candidates of the same columns
    index, first = np.unique(everything.index[widest], return_index=True)
    fit = evidence.posterior(Prior.free(index, everything.deviation[widest][first]))
    noise = noise_left(problem, fit)
    return noise.larger(problem.inflation(fit, white))


def noise_left(problem: RegressionProblem, fit: Posterior) -> Noise:
    """Return the noise that a fit leaves on the rows meant for it."""
    observed = problem.observed
    return Noise.of(problem.left(fit), problem.split.fitted, observed.segment, observed.least_noise)


def pruned(problem: RegressionProblem, solution: Solution) -> Solution:
    """Take out members that matter little or harm: precise, perhaps, but not physics to name.

    First those that cannot be as they are fitted: a competitor out of range ends no diagnosis.
    """
    while refused := impossible(problem, solution):
        solution = _less(problem, solution, refused)
    while (runaway := _runaway(problem, solution)) is not None:
        solution = _less(problem, solution, (runaway,))
    everywhere = range(problem.observed.n)  # what one joint lacks, bodies fit in part at all
    while idle := [member for member in solution.members if not _helps(problem, solution, member)]:
        size = {member: material(problem, solution, member, everywhere) for member in idle}
        solution = _less(problem, solution, (min(idle, key=lambda member: size[member]),))
    return solution


def _helps(problem: RegressionProblem, solution: Solution, member: int) -> bool:
    """Say whether a member lowers errors: much, and whichever blocks of time had been recorded.

    Every joint rubs, and which law of friction it follows is a choice that has to be made: for the
    likelier law either will do, where it is felt at all: some sensors see no friction. Whether a
    member is a finding is another question.
    """
    if _relieves_sensors(problem, solution, member) or relieves(problem, solution, member):
        return True
    everywhere = range(problem.observed.n)
    size = material(problem, solution, member, everywhere)
    if rubs(problem.candidates[member].effect) and size >= CONTRIBUTION.felt:
        return size >= CONTRIBUTION.material or sure(problem, solution, member, everywhere)
    return size >= CONTRIBUTION.material and sure(problem, solution, member, everywhere)


def _relieves_sensors(problem: RegressionProblem, solution: Solution, member: int) -> bool:
    """Say whether sensors would have to add as much as they may without a member.

    What they add is in no simulation, which then errs by it: so much, at least, as is worth naming.
    """
    of_sensors = ~problem.nuisance.entered
    fits = solution.fitted, without(problem, solution, member)
    ahead, behind = (
        ~np.isnan(solution.search.evidence.at_limit(fit)[: of_sensors.size]) & of_sensors
        for fit in fits
    )
    if not (behind & ~ahead).any():
        return False
    left, bare = (rmse(problem.left_without_sensors(fit), problem.observed.moving) for fit in fits)
    return bool((bare**2 - left**2 >= CONTRIBUTION.material**2 * left**2).any())


def _runaway(problem: RegressionProblem, solution: Solution) -> int | None:
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
    left = simulated(problem, solution)
    if not _errs_too_much(problem, solution, left):
        return None
    most = (1.0 - SOLVING.blamed) * _deviation(problem, solution, solution, left)
    gain = {
        member: _less(problem, solution, (member,)).gain
        for member in solution.members
        if _deviation_without(problem, solution, member) < most
    }
    errs = _in_errors(problem, solution, left)
    for member in sorted(gain, key=lambda member: gain[member], reverse=True):
        fewer = simulated(problem, _less(problem, solution, (member,)))
        if _in_errors(problem, solution, fewer) < errs:
            return member
    return None


def _in_errors(problem: RegressionProblem, whole: Solution, torque: FloatArray) -> float:
    """Return how large torques (K, n) are [errors that a fit leaves], joints summed up."""
    rows = problem.split.fitted
    scale = np.maximum(rmse(problem.left(whole.fitted), rows), TINY)
    return float(np.sum((rmse(torque, rows) / scale) ** 2))


def _errs_too_much(problem: RegressionProblem, solution: Solution, left: FloatArray) -> bool:
    """Say whether the simulation of a fit errs more at some joint than it may.

    It may err as the given one does, or somewhat more than the fit says.
    """
    rows = problem.split.fitted
    given = np.maximum(rmse(problem.observed.residual, rows), TINY)
    linear = rmse(problem.left(solution.fitted), rows)
    return bool((rmse(left, rows) > np.maximum(given, SOLVING.followed * linear)).any())


def _deviation(
    problem: RegressionProblem, whole: Solution, solution: Solution, left: FloatArray
) -> float:
    """Return how far a simulation is from its fit [errors that the whole set leaves, summed up].

    Args:
        problem: What is fitted.
        whole: The set that the errors are of.
        solution: The fit.
        left: What the simulation of it leaves, (K, n) [N m].
    """
    fit = solution.fitted
    return _in_errors(problem, whole, left - problem.left(fit) - problem.sensed(fit))


def _deviation_without(problem: RegressionProblem, solution: Solution, member: int) -> float:
    """Return the deviation of a fit with a member at zero, and the others as they are."""
    mean = solution.fitted.mean.copy()
    mean[own_coefficients(problem, solution, member)] = 0.0
    bare = replace(solution, fitted=replace(solution.fitted, mean=mean))
    return _deviation(problem, solution, bare, simulated(problem, bare))


def _less(problem: RegressionProblem, solution: Solution, some: Collection[int]) -> Solution:
    """Return a solution without some of its members, fitted again."""
    return solution.having(problem.less(solution.members, some))


def refined(
    problem: RegressionProblem, solution: Solution, progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Refine what is not linear in every member, one after the other.

    What is confused with a member is refined beside it, and takes its place where that makes it
    likelier: which of them is best on a grid of settings may be no more than the grid's chance.

    Returns:
        The problem with the refined candidates, and the solution with them for members.
    """
    members, candidates = list(solution.members), list(problem.candidates)
    for place, member in enumerate(members):
        progress("refining parameters", 0.65 + 0.1 * place / len(members))
        candidate = candidates[member]
        if candidate.hypothesis is None:
            continue
        others = joined(*(candidates[m].prior for m in members if m != member))
        around = Setting(
            problem.observed,
            problem.columns,
            problem.nuisance.prior,
            others,
            problem.target,
            solution.noise,
            problem.split.fitted,
            problem.level,
        )
        most = -np.inf
        for other in (member, *confused(problem, solution, member)):
            best = likeliest(problem, solution, member, other, around)
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
        return problem, solution
    return problem, fitted(problem, tuple(members), solution.noise)


def settled(
    problem: RegressionProblem, solution: Solution, progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Prune, refine and simplify a set; return it with the problem that has its candidates."""
    problem, solution = refined(problem, pruned(problem, solution), progress)
    simple = simplified(problem, pruned(problem, solution))
    problem, simple = _of_one_width(problem, simple, progress)
    return problem, pruned(problem, loaded(problem, simple))


def _of_one_width(
    problem: RegressionProblem, solution: Solution, progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Return a solution without stated friction over another width that found friction can have.

    Where friction along the range is found beside stated friction that is sharper, one takes from
    the other what it adds, and the widths of both were sought with the other there. So the rest is
    refined without the sharper one, which stays if it fits what the rest cannot. How well either
    foretells positions that only one block of time passed is chance, and says nothing of that.
    """
    for member in solution.members:
        candidates = problem.candidates
        if not candidates[member].other_width:
            continue
        rest = tuple(other for other in solution.members if other != member)
        beside = [other for other in rest if candidates[other].joints == candidates[member].joints]
        if not any(
            candidates[other].kind == "missing" and rubs(candidates[other].effect)
            for other in beside
        ):
            continue
        less, bare = refined(problem, fitted(problem, rest, solution.noise), progress)
        again = fitted(less, (*bare.members, member), solution.noise)
        left, lacking = (rmse(less.left(one.fitted), less.split.fitted) for one in (again, bare))
        if (lacking**2 - left**2 < CONTRIBUTION.material**2 * left**2).all():
            problem, solution = less, bare
    return problem, solution


def settled_around(
    problem: RegressionProblem, solution: Solution, progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Search again around a set, and settle the one that is found there.

    A gain acts on the friction that was found beside it, too, and an offset of an encoder on the
    load of a heavier link. Around the given simulation, what such a pair makes of one another looks
    like one effect more, or hides one.
    """
    problem, near = relinearised(problem, solution, progress)
    return settled(*solve(problem, progress, near), progress)


def suspects(
    problem: RegressionProblem, solution: Solution, joints: Collection[int]
) -> set[tuple[str, tuple[int, ...]]]:
    """Return the effects of which a fit has a value at its limit, and which may be wrong by it.

    At some joints (0-based) any of them; anywhere those whose value surely lies beyond its limit.
    None is of friction that is but sharper: there, a limit is no value that friction has.
    """
    limited = ~np.isnan(solution.search.evidence.at_limit(solution.fitted))
    if not limited.any():
        return set()
    turned = {
        problem.candidates[member].place
        for member in solution.members
        if merely_sharper(problem, solution, member)
    }
    limited &= ~problem.nuisance.of(turned)
    far = limited & _surely_beyond(problem, solution, limited)
    return {
        item.place
        for item, limit, beyond in zip(problem.nuisance.parameters, limited, far, strict=True)
        if item.of_effect
        and limit
        and (beyond or not item.place[1] or set(item.place[1]) & set(joints))
    }


def _surely_beyond(
    problem: RegressionProblem, solution: Solution, some: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Mark those of some nuisance coefficients (c,) that data put surely beyond their limits."""
    nuisance, search = problem.nuisance.prior, solution.search
    free = np.where(some, SOLVING.unbound * nuisance.deviation, nuisance.deviation)
    fit = posterior(
        search.evidence.products, replace(nuisance, deviation=free), search.prior(solution.members)
    )
    count = nuisance.index.size
    off, sure = fit.mean[:count], np.sqrt(np.diag(fit.covariance)[:count])
    return np.abs(off) - SOLVING.surely * sure > REACH * nuisance.deviation


def curved(problem: RegressionProblem, solution: Solution) -> bool:
    """Say whether a solution's simulation leaves clearly more or less than its linear fit says."""
    linear = problem.left_without_sensors(solution.fitted)
    moving = problem.observed.moving
    off, rest = rmse(simulated(problem, solution) - linear, moving), rmse(linear, moving)
    return bool((off > SOLVING.curved * rest).any())


def relinearised(
    problem: RegressionProblem, solution: Solution, progress: Progress
) -> tuple[RegressionProblem, tuple[int, ...]]:
    """Lay everything out again, with columns around the simulation of a solution.

    They hold near it, so that a set without what it has would be judged wrongly: beside a friction
    that is in, the gain of a sensor looks as that friction does.

    Returns:
        The problem, and the members of the solution on it.
    """
    improved = problem.beside(solution).simulation
    new = RegressionProblem.of(
        problem.observed.beside(problem.observed.simulation, around=improved), progress
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
