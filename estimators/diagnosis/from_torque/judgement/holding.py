"""Holding: the motion on which a verdict stands, and the values that it leaves as stated.

A friction slope learned from slow motion says little of fast motion. So a verdict has the range of
positions, speeds and loads of the rows that were fitted and judged, by joint. A stated value of
which these rows say next to nothing stays as it is, whatever else is found.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.judgement import HOLDING
from estimators.diagnosis.verdict import Holds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from limo_driver.types import FloatArray


def held_by(problem: RegressionProblem, solution: Solution) -> Holds:
    """Return the range of motion of the rows that count, and the friction that they do not show."""
    observed = problem.observed
    rows = observed.moving
    return Holds(
        position=_ranges(observed.slow.position, rows),
        speed=_ranges(np.abs(observed.slow.velocity), rows),
        load=_ranges(observed.load[observed.kept], rows),
        as_stated=_as_stated(problem, solution),
    )


def _ranges(values: FloatArray, rows: NDArray[np.bool_]) -> tuple[tuple[float, float], ...]:
    """Return least and largest of values (K, n) over the rows (K, n) of each joint."""
    some = [column[use] for column, use in zip(values.T, rows.T, strict=True)]
    return tuple((float(x.min()), float(x.max())) if x.size else (0.0, 0.0) for x in some)


def _as_stated(problem: RegressionProblem, solution: Solution) -> tuple[str, ...]:
    """Name the stated sizes of friction of which the fit knows hardly more than was stated."""
    prior, fitted = problem.nuisance.prior, solution.fitted
    known = fitted.deviation[: prior.index.size]
    at_limit = ~np.isnan(solution.search.evidence.at_limit(fitted))
    open_ = (known > HOLDING.open * prior.deviation) & (prior.deviation > 0) & ~at_limit
    return tuple(
        item.name
        for item, unseen in zip(problem.nuisance.parameters, open_.tolist(), strict=True)
        if unseen and item.of_effect
    )
