"""Simplicity: of two explanations that predict alike, the one with fewer parameters has the name.

A law with many free parameters follows whatever is there: presliding with many elements becomes an
offset, or friction that is a little higher. Where a simpler effect of the same joints, or of one of
two that are coupled, explains most of the same, and predicts motion held out no worse, it takes the
place of the other. Two that were refined beside each other have paid for what they may choose, and
few of the rows held out are at the reversals in which play and presliding differ: of those, the
simpler one has the name where the evidence cannot tell them.

A load at the flange and another body of the last link are one and the same to every joint. Links
are made as they were drawn, and loads come and go: so a load has the name where there can be one.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import (
    TINY,
    coefficients,
    in_turn,
    puts_values_at_limits,
    surely_better,
    surely_less,
)
from estimators.diagnosis.from_torque.fitting.laws import compete
from estimators.diagnosis.from_torque.fitting.problem import simulated
from estimators.diagnosis.headline import LINK_INERTIA
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.fitting import CANDIDATES, CONTRIBUTION
from estimators.regression.definite import first_best, ranked
from estimators.regression.evidence import REACH
from limo_driver.physics import Payload
from limo_driver.physics.effect import SensorEffect

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.hypotheses.candidates import Candidate
    from limo_driver.types import FloatArray


def simplified(solution: Solution) -> Solution:
    """Return a solution with simpler members, and fewer, wherever those predict as well."""
    for member in solution.members:
        solution = _with_simpler(solution, member)
    while (fewer := _with_one_for_two(solution)) is not solution:
        solution = fewer
    return solution


def _with_simpler(solution: Solution, member: int) -> Solution:
    """Put the simplest effect that does as well into a member's place; the likeliest of those."""
    problem = solution.problem
    search, candidates = solution.search, problem.candidates
    own = candidates[member]
    rest, others = _in_place_of(solution, (member,))
    enough, as_likely = _enough(solution, rest), solution.gain - CONTRIBUTION.tellable
    simpler = [
        i
        for i in others
        if _is_within(candidates[i].joints, own.joints)
        and candidates[i].effect != own.effect  # which law of it carries over, its laws decide
        and search.gain((*rest, i)) >= (as_likely if compete(candidates[i], own) else enough)
    ]
    simpler = ranked(simpler, lambda i: search.gain((*rest, i)))
    simpler.sort(key=lambda i: _freedom(candidates[i]))
    problem.rotation(solution.noise, [*solution.members, *simpler])  # sums of all at once
    for other in simpler:
        new = solution.having((*rest, other))
        everywhere = range(problem.observed.n)
        if puts_values_at_limits(solution, new.fitted):
            continue  # what a body does at other joints would be laid to stated values
        # one that is much likelier, since others were refined, needs no proof that it does as well
        if new.gain > solution.gain + CANDIDATES.missing or not surely_better(
            solution, solution.members, new.members, everywhere
        ):
            return new
    return solution


def _with_one_for_two(solution: Solution) -> Solution:
    """Put one effect into the place of two of a joint where the second would bring too little.

    Friction by a load that drives the joint is half of that by any load, less a gain: the pair fits
    a little better wherever the law of the one is not exact, but both names would be wrong.
    """
    search, candidates = solution.search, solution.problem.candidates
    base = {candidates[i].place for i in solution.problem.base}
    named = [i for i in solution.members if candidates[i].place not in base]
    for pair in combinations(named, 2):
        joints = candidates[pair[0]].joints
        if not joints or candidates[pair[1]].joints != joints:
            continue
        rest, others = _in_place_of(solution, pair)
        gains = {i: search.gain((*rest, i)) for i in others if candidates[i].joints == joints}
        if not gains or max(gains.values()) < _enough(solution, rest):
            continue
        new = solution.having((*rest, first_best(gains, gains.__getitem__)))
        if not puts_values_at_limits(solution, new.fitted) and _does_as_well(solution, new):
            return new
    return solution


def _in_place_of(solution: Solution, gone: Sequence[int]) -> tuple[tuple[int, ...], list[int]]:
    """Return the other members, and the candidates that choose less than some members do."""
    candidates = solution.problem.candidates
    rest = tuple(i for i in solution.members if i not in gone)
    taken = {candidates[i].slot for i in rest}
    freedom = sum(_freedom(candidates[i]) for i in gone)
    return rest, [
        i
        for i, candidate in enumerate(candidates)
        if candidate.slot not in taken
        and _freedom(candidate) < freedom
        and not _is_of_sensor(candidate)
    ]


def _enough(solution: Solution, rest: Sequence[int]) -> float:
    """Return the evidence that a set has to have, to have most of what is beyond its rest [nat]."""
    without = solution.search.gain(rest)
    return without + CONTRIBUTION.most * (solution.gain - without)


def _does_as_well(solution: Solution, fewer: Solution) -> bool:
    """Say whether fewer members leave hardly more: less than a finding has to take off.

    On rows that are held out in turn, and on all, which have every reversal.
    """
    in_turns, rows = in_turn(solution, solution.members, fewer.members)
    everywhere = [solution.problem.left(one.fitted) for one in (solution, fewer)]
    most = 1.0 + CONTRIBUTION.material**2
    return all(
        bool((rmse(behind, use) ** 2 <= most * np.maximum(rmse(ahead, use), TINY) ** 2).all())
        for (ahead, behind), use in (
            (in_turns, rows),
            (everywhere, solution.problem.observed.moving),
        )
    )


def loaded(solution: Solution) -> Solution:
    """Return a solution with a load at the flange for a wrong last link, where one can be.

    It can where it has mass, its centre is near enough, and the simulation with it predicts motion
    held out no worse.
    """
    problem = solution.problem
    candidates, last = problem.candidates, (problem.observed.n - 1,)
    places = [candidates[i].place for i in solution.members]
    if (LINK_INERTIA, last) not in places:
        return solution
    wrong = solution.members[places.index((LINK_INERTIA, last))]
    rest = tuple(i for i in solution.members if i != wrong)
    loads = [
        i
        for i, item in enumerate(candidates)
        if item.place == (Payload.name, last) and item.kind == "missing"  # not a stated one's mass
    ]
    if not loads:
        return solution
    load = first_best(loads, lambda i: solution.search.gain((*rest, i)))
    new = solution.having(tuple(load if i == wrong else i for i in solution.members))
    mass, *moment = coefficients(new, load)[:4].tolist()
    unit, lever = candidates[load].prior.deviation[:2].tolist()  # [kg], [kg m]
    if float(np.linalg.norm(moment)) > REACH * mass * lever / unit:  # as of any negative mass
        return solution
    ahead, behind = (simulated(item) for item in (new, solution))
    return solution if _surely_worse(problem, ahead, behind) else new


def _is_within(some: tuple[int, ...], own: tuple[int, ...]) -> bool:
    """Say whether an effect of some joints acts at no others than one of its own."""
    return some == own or (bool(some) and set(some) < set(own))


def _freedom(candidate: Candidate) -> int:
    """Count what a candidate may choose: its coefficients and the settings that were sought.

    How sharp a sign is belongs to every dry friction, whether it is sought or not.
    """
    count, hypothesis = candidate.prior.index.size, candidate.hypothesis
    if hypothesis is None:
        return count
    sharp = {
        getattr(term, known.name)
        for term in hypothesis.terms
        for known in term.parameters()
        if known.smooths
    }
    return count + sum(setting not in sharp for setting in hypothesis.settings)


def _is_of_sensor(candidate: Candidate) -> bool:
    """Say whether a candidate is no simpler law of what a joint does, but of who tells it.

    Around a simulation that has it, the gain of a sensor is all of what was found.
    """
    hypothesis = candidate.hypothesis
    return hypothesis is not None and any(isinstance(e, SensorEffect) for e in hypothesis.terms)


def _surely_worse(problem: RegressionProblem, ahead: FloatArray, behind: FloatArray) -> bool:
    """Say whether motion held out is surely predicted worse, whichever blocks had been recorded.

    Args:
        problem: What is compared.
        ahead: Residual (K, n) of what would take a name [N m].
        behind: That of what has it.
    """
    rows = problem.split.held_out
    return surely_less(behind, ahead, rmse(behind, rows), problem.observed, rows)
