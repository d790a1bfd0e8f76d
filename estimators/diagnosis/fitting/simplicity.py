"""Simplicity: of two explanations that predict alike, the one with fewer parameters has the name.

A law with many free parameters follows whatever is there: presliding with many elements becomes an
offset, or friction that is a little higher. Where a simpler effect of the same joints explains most
of the same, and predicts motion held out no worse, it takes the place of the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.residuals.held_out import rmse, surely_positive
from estimators.diagnosis.settings.fitting import CONTRIBUTION
from limo_driver.physics.effect import SensorEffect

if TYPE_CHECKING:
    from estimators.diagnosis.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.selection.candidates import Candidate


def simplified(problem: RegressionProblem, solution: Solution) -> Solution:
    """Return a solution with simpler members wherever those predict as well."""
    for member in solution.members:
        solution = _with_simpler(problem, solution, member)
    return solution


def _with_simpler(problem: RegressionProblem, solution: Solution, member: int) -> Solution:
    """Put the simplest effect that does as well into a member's place; the likeliest of those."""
    search, candidates = solution.search, problem.candidates
    own = candidates[member]
    rest = tuple(i for i in solution.members if i != member)
    taken = {candidates[i].slot for i in rest}
    without = search.gain(rest)
    enough = without + CONTRIBUTION.most * (solution.gain - without)
    simpler = [
        i
        for i, candidate in enumerate(candidates)
        if candidate.joints == own.joints
        and candidate.effect != own.effect  # which law of it carries over better, its laws decide
        and candidate.slot not in taken
        and _freedom(candidate) < _freedom(own)
        and not _is_of_sensor(candidate)
        and search.gain((*rest, i)) >= enough
    ]
    simpler.sort(key=lambda i: (_freedom(candidates[i]), -search.gain((*rest, i))))
    for other in simpler:
        new = solution.having((*rest, other))
        if not _surely_worse(problem, new, solution):
            return new
    return solution


def _freedom(candidate: Candidate) -> int:
    """Count what a candidate may choose: its coefficients and the settings that were sought."""
    hypothesis = candidate.hypothesis
    return candidate.prior.index.size + (0 if hypothesis is None else len(hypothesis.settings))


def _is_of_sensor(candidate: Candidate) -> bool:
    """Say whether a candidate is no simpler law of what a joint does, but of who tells it.

    Around a simulation that has it, the gain of a sensor is all of what was found.
    """
    hypothesis = candidate.hypothesis
    return hypothesis is not None and any(isinstance(e, SensorEffect) for e in hypothesis.terms)


def _surely_worse(problem: RegressionProblem, new: Solution, old: Solution) -> bool:
    """Say whether motion held out is surely predicted worse, whichever blocks had been recorded."""
    rows = problem.split.held_out
    ahead, behind = problem.left(new.fitted), problem.left(old.fitted)
    scale = np.maximum(rmse(behind, rows), 1e-12)
    return surely_positive((ahead**2 - behind**2) / scale**2, problem.observed, rows)
