"""Solving: find the set of effects of most evidence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import TINY
from estimators.diagnosis.from_torque.fitting.lateness import has_long, long_after
from estimators.diagnosis.from_torque.fitting.problem import (
    RegressionProblem,
    Solution,
    fitted,
    lost_by,
    search_on,
    simulated,
)
from estimators.diagnosis.from_torque.hypotheses.ripple import ripples
from estimators.diagnosis.from_torque.residuals.noise import Noise, roughness
from estimators.diagnosis.from_torque.selection.candidates import entered
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CONTRIBUTION, SOLVING
from estimators.regression.evidence import Prior, joined
from limo_driver.physics import TorqueRipple

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from estimators.diagnosis.stages import Progress
    from estimators.regression.evidence import Posterior
    from limo_driver.physics import Hypothesis


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
