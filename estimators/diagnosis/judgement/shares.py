"""Shares: what the error that tolerances leave comes from, as parts that add up to 1 at most.

Values that move inside their tolerances may take most of the given simulation's error. Shares are
of what they leave by themselves on motion held out: its mean square beyond that of the noise floor,
summed over joints. The set of effects takes a part of it, and the rest stays. Effects overlap: what
is lost without each of them may add up to more or less than what is lost without all, so the part
of the set is divided among its members in proportion to what is lost without each.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.fitting.contribution import contribution
from estimators.diagnosis.fitting.problem import fitted
from estimators.diagnosis.residuals.held_out import reducible_removed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.fitting.problem import Bench, Solution
    from limo_driver.types import FloatArray


def left_by_tolerances(bench: Bench, solution: Solution) -> FloatArray:
    """Return what is left with values moved inside their tolerances and no effect, (K, n)."""
    if bench.first is not None:  # columns around what was found say nothing of a set without it
        return left_by_tolerances(bench.first, fitted(bench.first, (), solution.noise))
    search = solution.search
    return bench.left(search.evidence.posterior(search.prior(())))


def shares_of(
    bench: Bench, solution: Solution, alone: FloatArray, after: FloatArray, floor: FloatArray
) -> dict[int, float]:
    """Return the share that goes with each member of the set.

    Args:
        bench: What was compared.
        solution: The set, fitted to the rows meant for it.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
        floor: Noise floor, (n,) [N m].
    """
    taken = max(reducible_removed(alone, after, floor), 0.0)
    lost = {
        member: max(float(contribution(bench, solution, member).sum()), 0.0)
        for member in solution.members
    }
    total = max(sum(lost.values()), 1e-12)
    return {member: taken * part / total for member, part in lost.items()}


def left_at(
    joints: Sequence[int], alone: FloatArray, after: FloatArray, floor: FloatArray
) -> tuple[float, tuple[float, ...]]:
    """Return the share that stays at some joints.

    Args:
        joints: Which, 0-based.
        alone: Held-out RMSE with values moved inside their tolerances and no effect, (n,) [N m].
        after: That of the improved simulation.
        floor: Noise floor, (n,) [N m].

    Returns:
        Of the arm's error, and of each of those joints' own.
    """
    left = np.maximum(after**2 - floor**2, 0.0)
    whole = np.maximum(np.maximum(alone**2 - floor**2, left), 1e-12)  # nothing leaves no 0 / 0
    own = tuple(float(left[j] / whole[j]) for j in joints)
    return float(left[list(joints)].sum() / whole.sum()), own
