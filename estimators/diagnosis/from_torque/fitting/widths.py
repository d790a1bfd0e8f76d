"""Widths: over which speeds stated dry friction turns its sign is guessed, and its size is known.

A change of friction may act over another width than is stated. Beside what tolerances allow, that
is also how a fit says that all of it is sharper: less of it over the stated width, and as much more
over the other. Only their sum tells whether there is more friction than there may be.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.fitting.contribution import coefficients
from estimators.regression.evidence import REACH

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from limo_driver.types import FloatArray


def merely_sharper(problem: RegressionProblem, solution: Solution, member: int) -> bool:
    """Say whether a member makes stated friction sharper or softer, of a size that it may have."""
    candidate = problem.candidates[member]
    if not candidate.other_width:
        return False
    sizes = problem.nuisance.of([candidate.place])
    # of the given simulation: here, values may be held as they are stated
    deviation = (problem.first or problem).nuisance.prior.deviation[sizes]
    return bool((np.abs(change_of(problem, solution, member)) <= REACH * deviation).all())


def change_of(problem: RegressionProblem, solution: Solution, member: int) -> FloatArray:
    """Return by which part of it each size of a stated effect changes, (c,).

    That is what its tolerance takes of the change, and what the member adds.
    """
    sizes = problem.nuisance.of([problem.candidates[member].place])
    within = solution.fitted.mean[: sizes.size][sizes]
    return within + coefficients(problem, solution, member)
