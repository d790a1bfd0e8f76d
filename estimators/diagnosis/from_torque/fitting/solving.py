"""Solving: find the set of effects of most evidence.

Lateness: a lag or a delay of all that the torque of a joint is made of.

Torque is linear in how late it comes only while that is short beside what changes. The ripple of a
turning joint comes at another phase each way; what fits both best is too small, and seems to have
friction beside it that is not there. So every column of a joint is laid later, by some times, and
the set is taken up again around the lateness with which it explains most. A joint that is late in
the set already is asked again, without that: of a delay longer than half a period of its motion,
a lag is what a fit comes to from the start.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import TINY
from estimators.diagnosis.from_torque.fitting.problem import (
    RegressionProblem,
    Solution,
    fitted,
    lost_by,
    search_on,
    simulated,
)
from estimators.diagnosis.from_torque.hypotheses.candidates import entered
from estimators.diagnosis.from_torque.hypotheses.catalogue import found_in
from estimators.diagnosis.from_torque.hypotheses.ripple import ripples
from estimators.diagnosis.from_torque.residuals.noise import Noise, roughness
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CANDIDATES, CONTRIBUTION, LATENESS, SOLVING
from estimators.regression.definite import inverse_root
from estimators.regression.evidence import Prior, joined
from limo_driver.physics import TimeDelay, TorqueRipple
from limo_driver.physics.effects.delay import DELAYED, LAGGING
from limo_driver.types import FloatArray

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from estimators.diagnosis.stages import Progress
    from estimators.regression.evidence import Posterior
    from limo_driver.physics import Hypothesis

_LAWS: Final = {"lag": LAGGING, "delay": DELAYED}  # of the parameter
_IN_TIME: Final = TimeDelay(joint=1)


def long_after(joints: int) -> Iterator[Hypothesis]:
    """Yield a lag and a delay at each of some joints, by which torque is not linear any more.

    They compete, but explain nothing of the noise: where rows are few, two columns more a joint
    make it seem smaller, and then chance has names.
    """
    for joint in range(1, joints + 1):
        for name, law in _LAWS.items():
            yield TimeDelay.of_time(joint, name, law, LATENESS.long)


def has_long(candidate: Candidate) -> bool:
    """Say whether a candidate is one of those."""
    hypothesis = candidate.hypothesis
    return (
        hypothesis is not None
        and hypothesis.effect == TimeDelay.name
        and hypothesis.settings == (LATENESS.long,)
    )


def with_torque_delay(
    problem: RegressionProblem, solution: Solution, unknown: Collection[int]
) -> tuple[RegressionProblem, Solution] | None:
    """Return a set with the lag or delay in it that brings most, to be taken up again around it.

    Args:
        problem: What the set was found on.
        solution: A set without that lateness, or with another of that joint.
        unknown: Joints (0-based) that it leaves unexplained, which come first.

    Returns:
        The problem with that candidate, and the set; None where no lateness brings enough.
    """
    found = [
        _of_joint(problem, solution, joint, long=joint in unknown)
        for joint in range(problem.observed.n)
    ]
    least = CANDIDATES.missing + np.log(len(found) * len(_LAWS) * len(LATENESS.times))
    clear = [item for item in found if item is not None and item.gain >= least]
    best = max(clear, key=lambda item: (item.joint in unknown, item.gain), default=None)
    if best is None:
        return None
    hypothesis = TimeDelay.of_time(best.joint + 1, best.name, _LAWS[best.name], best.time)
    candidate = entered(hypothesis, problem.observed, problem.columns, problem.level)
    if candidate is None:
        return None
    problem = problem.with_candidates([*problem.candidates, candidate])
    rest = best.beside
    whole = fitted(problem, (*rest.members, len(problem.candidates) - 1), rest.noise)
    mean = np.append(rest.fitted.mean, 1.0)
    mean[best.changed] = best.coefficients
    return problem, replace(whole, fitted=replace(whole.fitted, mean=mean))


def _of_joint(
    problem: RegressionProblem, solution: Solution, joint: int, *, long: bool
) -> _Late | None:
    """Return how late the torque of a joint (0-based) is taken to be, if later is better.

    All the times are tried of a joint that may be late by much (`long`). Elsewhere those do that
    begin to help, beside effects of the joint: without any, the lateness competed already.
    """
    members = [problem.candidates[member] for member in solution.members]
    rest = tuple(
        i
        for i, item in zip(solution.members, members, strict=True)
        if not (item.effect == TimeDelay.name and joint in item.joints)
    )
    if len(rest) == len(members):
        alone = _OneJoint.of(problem, solution, joint)
        return _latest(alone, solution, _IN_TIME, long=long) if alone.own or long else None
    known = found_in(problem.under(solution).simulation, TimeDelay.name, (joint + 1,), missing=True)
    if not isinstance(known, TimeDelay):
        return None
    without = fitted(problem, rest, solution.noise)
    return _latest(_OneJoint.of(problem, without, joint), without, known, long=True)


@dataclass(frozen=True)
class _Late:
    """How late one joint's torque is taken to be."""

    joint: int  # 0-based
    name: str  # parameter of `TimeDelay`
    time: float  # [s]
    gain: float  # in log evidence over what is known of it [nat]
    beside: Solution  # the set without lateness of that joint
    changed: list[int]  # coefficients of the set's fit that are others then
    coefficients: FloatArray


@dataclass(frozen=True)
class _OneJoint:
    """The fit of one joint alone, whose columns can be laid later."""

    joint: int
    time: FloatArray  # (K,) [s]
    segments: list[slice]
    columns: FloatArray  # (K, c), times their prior deviation
    deviation: FloatArray  # (c,)
    place: list[int]  # of each column in the coefficients of the set, (c,)
    own: list[int]  # columns of members that act on this joint alone
    simulated: FloatArray  # (K,) [N m]
    measured: FloatArray  # (K,) [N m]
    whiten: Callable[[FloatArray], FloatArray]  # (K, ...) -> rows that are fitted

    @classmethod
    def of(cls, problem: RegressionProblem, solution: Solution, joint: int) -> _OneJoint:
        members = [problem.candidates[member] for member in solution.members]
        priors = [problem.nuisance.prior, *(item.prior for item in members)]
        index = np.concatenate([prior.index for prior in priors])
        deviation = np.concatenate([prior.deviation for prior in priors])
        alone = np.concatenate(
            [
                np.zeros(priors[0].index.size, dtype=bool),
                *(np.full(item.prior.index.size, item.joints == (joint,)) for item in members),
            ]
        )
        values, at = problem.columns.of_joint(joint)
        column = {int(k): c for c, k in enumerate(at)}
        place = [i for i, k in enumerate(index) if int(k) in column and deviation[i] > 0]
        rows = problem.split.fitted[:, joint]
        measured = problem.observed.measured[:, joint]
        return cls(
            joint,
            problem.observed.slow.time,
            problem.observed.stretches,
            values[:, [column[int(index[i])] for i in place]] * deviation[place],
            deviation[place],
            place,
            [c for c, i in enumerate(place) if alone[i]],
            measured - problem.target[:, joint],
            measured,
            lambda values: solution.noise.whiten(values, joint, rows),
        )

    def fit(self, late: TimeDelay) -> tuple[float, FloatArray]:
        """Return log evidence [nat] and coefficients (c,) with everything so much later."""
        both = np.column_stack([self.columns, self.simulated])
        both = np.concatenate([late.late(self.time[rows], both[rows]) for rows in self.segments])
        A, y = self.whiten(both[:, :-1]), self.whiten(self.measured - both[:, -1])
        root = inverse_root(A.T @ A + np.eye(A.shape[1]))
        part = root @ (A.T @ y)
        evidence = 0.5 * float(part @ part - y @ y) + float(np.log(np.diag(root)).sum())
        return evidence, (root.T @ part) * self.deviation


def _latest(alone: _OneJoint, beside: Solution, known: TimeDelay, *, long: bool) -> _Late | None:
    """Return how late the torque of a joint is taken to be, if another than known is better.

    Args:
        alone: Fit of that joint.
        beside: The set, without lateness of that joint.
        known: What a set has of it.
        long: Whether to try times that do not begin to help.
    """
    least, _ = alone.fit(known)
    best: _Late | None = None
    for name in _LAWS:
        own: _Late | None = None
        for k, time in enumerate(LATENESS.times):
            if k == LATENESS.asked and own is None and not long:
                break  # what does not begin to help is not there
            evidence, coefficients = alone.fit(TimeDelay(joint=alone.joint + 1, **{name: time}))
            gain = evidence - least
            if gain > (0.0 if own is None else own.gain):
                changed = [alone.place[c] for c in alone.own]
                values = coefficients[alone.own]
                own = _Late(alone.joint, name, time, gain, beside, changed, values)
        if own is not None and (best is None or own.gain > best.gain):
            best = own
    return best


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
    problem, search = problem.holding(None), _Search(progress, near)
    noise = noise_of_everything(problem)
    if not any(has_long(candidate) for candidate in problem.candidates):
        problem = _with(problem, long_after(problem.observed.n))
    problem = _scanned(problem, fitted(problem, problem.base, noise))
    solution = search.best(problem, noise)
    problem = _scanned(problem, solution)  # of what the largest effects hid
    solution = search.until_it_stays(problem, solution)
    limits = solution.search.evidence.at_limit(solution.fitted)
    limits[problem.observed.chain.width :] = np.nan  # bodies come first
    if not np.isnan(limits).all():
        limited = problem.holding(limits)
        more = search.until_it_stays(limited, solution)
        if set(more.members) != set(solution.members):
            problem, solution = limited, more
    return search.of_possible_links(*search.of_possible_bodies(problem, solution))


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
        return Solution(found.members, search, noise, posterior, found.gain)

    def until_it_stays(self, problem: RegressionProblem, solution: Solution) -> Solution:
        """Return the set at which noise and search in turn stay."""
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

    def of_possible_bodies(
        self, problem: RegressionProblem, solution: Solution
    ) -> tuple[RegressionProblem, Solution]:
        """Return a solution, or the best one without a body that would bring less within reach."""
        search = self
        while lost := lost_by(problem, solution):
            worst = max(lost, key=lambda member: lost[member])
            if lost[worst] < CONTRIBUTION.tellable:
                break
            fewer, search = search.without(problem, {problem.candidates[worst].place})
            other = search.until_it_stays(fewer, solution)
            if solution.search.gain(other.members) < solution.gain - lost[worst]:
                break
            problem, solution = fewer, other
        return problem, solution

    def of_possible_links(
        self, problem: RegressionProblem, solution: Solution
    ) -> tuple[RegressionProblem, Solution]:
        """Return a solution, or the best one without wrong links where those cannot be."""
        links = {item.place for item in problem.candidates if item.effect == LINK_INERTIA}
        if not any(problem.candidates[member].place in links for member in solution.members):
            return problem, solution
        rows = problem.split.fitted
        linear = np.maximum(rmse(problem.left_without_sensors(solution.fitted), rows), TINY)
        own = rmse(simulated(problem, solution), rows)
        if not (own > SOLVING.followed * linear).any():
            return problem, solution
        fewer, search = self.without(problem, links)
        other = search.until_it_stays(fewer, solution)
        its = rmse(simulated(fewer, other), rows)
        nearer = np.sum((its / linear) ** 2) < np.sum((own / linear) ** 2)
        return (fewer, other) if nearer else (problem, solution)


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
