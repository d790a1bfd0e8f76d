"""Solving: find the set of effects of most evidence."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
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
from estimators.diagnosis.from_torque.hypotheses.candidates import entered
from estimators.diagnosis.from_torque.hypotheses.ripple import ripples
from estimators.diagnosis.from_torque.residuals.noise import Noise, roughness
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CONTRIBUTION, SOLVING
from estimators.regression.evidence import Prior, joined
from limo_driver.physics import TorqueRipple

if TYPE_CHECKING:
    from estimators.diagnosis.stages import Progress
    from estimators.regression.evidence import Posterior
    from limo_driver.physics import Hypothesis


def solve(
    problem: RegressionProblem, progress: Progress, near: tuple[int, ...] | None = None
) -> Solution:
    """Find the set of effects, or the best one near a set; noise and set in turn until both stay.

    The first noise is what a fit of everything at once leaves. Taken from a residual that still
    has an effect in it, the noise would explain that effect, and hide it.

    While sets compete, tolerances are the deviations of normal priors, which thousands of rows
    outvote; fitted values stay inside them. So once more with those of bodies held that a fit has
    at their limit: what they would have explained beyond may be an effect, or a body that is wrong.
    The problem of what is returned has its candidates and limits.
    """
    problem, search = problem.holding(None), _Search(progress, near)
    noise = noise_of_everything(problem)
    if not any(has_long(candidate) for candidate in problem.candidates):
        problem = with_hypotheses(problem, long_after(problem.observed.n))
    problem = _scanned(fitted(problem, problem.base, noise))
    solution = search.best(problem, noise)
    problem = _scanned(solution)  # of what the largest effects hid
    solution = search.until_it_stays(problem, solution)
    limits = solution.search.evidence.at_limit(solution.fitted)
    limits[problem.observed.chain.width :] = np.nan  # bodies come first
    if not np.isnan(limits).all():
        more = search.until_it_stays(problem.holding(limits), solution)
        if set(more.members) != set(solution.members):
            solution = more
    return search.of_possible_links(search.of_possible_bodies(solution))


@dataclass(frozen=True)
class _Search:
    """The search for a set, anywhere or near another one."""

    progress: Progress
    near: tuple[int, ...] | None

    def best(self, problem: RegressionProblem, noise: Noise) -> Solution:
        """Return the set of most evidence under a noise."""
        progress = self.progress
        progress("comparing explanations", 0.4)
        search = search_on(problem, noise)
        found = search.best() if self.near is None else search.around(self.near)
        posterior = search.evidence.posterior(search.prior(found.members))
        return Solution(problem, found.members, search, noise, posterior, found.gain)

    def until_it_stays(self, problem: RegressionProblem, solution: Solution) -> Solution:
        """Return the set of a problem at which noise and search in turn stay, from one on."""
        for _ in range(SOLVING.rounds):
            before = set(solution.members)
            solution = self.best(problem, noise_left(problem, solution.fitted))
            if set(solution.members) == before:
                break
        return solution

    def without(
        self, problem: RegressionProblem, places: Collection[tuple[str, tuple[int, ...]]]
    ) -> tuple[RegressionProblem, _Search]:
        """Return the problem, and the search, without effects at some places."""
        near = self.near and tuple(
            i for i in self.near if problem.candidates[i].place not in places
        )
        return problem.without_places(places), replace(self, near=near)

    def of_possible_bodies(self, solution: Solution) -> Solution:
        """Return a solution, or the best one without a body that would bring less within reach."""
        search = self
        while lost := lost_by(solution):
            worst = max(lost, key=lambda member: lost[member])
            if lost[worst] < CONTRIBUTION.tellable:
                break
            problem = solution.problem
            fewer, search = search.without(problem, {problem.candidates[worst].place})
            other = search.until_it_stays(fewer, solution)
            if solution.search.gain(other.members) < solution.gain - lost[worst]:
                break
            solution = other
        return solution

    def of_possible_links(self, solution: Solution) -> Solution:
        """Return a solution, or the best one without wrong links where those cannot be."""
        problem = solution.problem
        links = {item.place for item in problem.candidates if item.effect == LINK_INERTIA}
        if not any(problem.candidates[member].place in links for member in solution.members):
            return solution
        rows = problem.split.fitted
        linear = np.maximum(rmse(problem.left_without_sensors(solution.fitted), rows), TINY)
        own = rmse(simulated(solution), rows)
        if not (own > 2 * linear).any():
            return solution
        fewer, search = self.without(problem, links)
        other = search.until_it_stays(fewer, solution)
        its = rmse(simulated(other), rows)
        nearer = np.sum((its / linear) ** 2) < np.sum((own / linear) ** 2)
        return other if nearer else solution


def _scanned(solution: Solution) -> RegressionProblem:
    """Return the problem with the candidates that have to be looked for in the residual."""
    problem = solution.problem
    chosen = [problem.candidates[member].hypothesis for member in solution.members]
    known = {
        item.joints[0]: item.settings
        for item in chosen
        if item is not None and item.effect == TorqueRipple.name
    }
    return with_hypotheses(problem, ripples(problem.observed, problem.left(solution.fitted), known))


def with_hypotheses(problem: RegressionProblem, more: Iterable[Hypothesis]) -> RegressionProblem:
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
