"""Which condition of a request is in the way, and what would have to change."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limopa.feasibility import Condition

if TYPE_CHECKING:
    from limo_driver.types import FloatArray
    from limopa.feasibility import Feasibility

# What sets each condition, as functions name it; the commands have an option for each.
SET_BY: Final = {
    Condition.JOINT_LIMITS: "`joint_margin`",
    Condition.TABLE: "`table_height`",
    Condition.SELF_COLLISION: "`clearance`",  # also what is kept from the table
}


class Hindrance(NamedTuple):
    """What of a request cannot be met."""

    condition: Condition
    message: str  # how far it is from being met, and the argument that asks for it


def hindrance(space: Feasibility, position: FloatArray) -> Hindrance:
    """Return the fewest conditions without which one of some configurations would be feasible.

    Args:
        space: The conditions.
        position: Configurations of which none is feasible, (T, n) [rad].
    """
    broken = space.check_scaffold(position).broken
    rows = np.logical_or.reduce(list(broken.values()))
    position, broken = position[rows], {name: found[rows] for name, found in broken.items()}
    for many in range(1, len(broken) + 1):
        freed: dict[tuple[Condition, ...], FloatArray] = {}
        for named in combinations(broken, many):
            others = [found for name, found in broken.items() if name not in named]
            freed[named] = position[~np.logical_or.reduce([np.zeros_like(rows[rows]), *others])]
        most = max(freed, key=lambda named: len(freed[named]))
        if len(freed[most]):
            missed = "; ".join(_missed_by(space, name, freed[most]) for name in most)
            return Hindrance(most[0], missed)
    raise AssertionError("without all conditions every configuration is feasible")


def set_by(condition: str, space: Feasibility) -> str:
    """Return the argument that asks for a condition."""
    if condition == Condition.WORKSPACE:
        return "`region`" if space.workspace.throughout else "`Workspace.radius`"
    return SET_BY[Condition(condition)]


def _missed_by(space: Feasibility, condition: Condition, position: FloatArray) -> str:
    """Say how near a condition the best of some configurations comes, (T, n)."""
    need = space.surroundings.clearance
    gap, lowest = space.clearances(position)
    option = set_by(condition, space)
    if condition == Condition.TABLE:
        height = space.surroundings.table_height
        best = float(lowest.min(axis=1).max())
        missed = f"the table is {height:g} m above the base, expected at most {best - need:.3g} m"
        if best > height:  # it is what is to be kept from it that is too much
            missed = (
                f"links come {best - height:.3g} m off the table, where {need:g} m are asked for"
            )
            option = SET_BY[Condition.SELF_COLLISION]
    elif condition == Condition.SELF_COLLISION:
        best = float(gap.min(axis=1).max())
        apart = "links touch" if best <= 0 else f"links come {best:.3g} m apart at most"
        missed = f"{apart}, where {need:g} m are asked for"
    elif condition == Condition.WORKSPACE:
        best = float(space.outside(position).min())
        missed = f"at best the flange is {best:.3g} m away from {space.workspace.in_words}"
    else:
        over = np.maximum(space.lower - position, position - space.upper)
        nearest = over[over.max(axis=1).argmin()]
        asked = space.surroundings.joint_margin
        best = np.degrees(asked - nearest.max())
        missed = f"joint {nearest.argmax() + 1} is to keep {np.degrees(asked):g} deg from the ends "
        missed += f"of its range, expected at most {best:.3g} deg"
    return f"{missed} ({option})"
