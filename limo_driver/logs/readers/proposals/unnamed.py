"""Columns of which no name says what they are: their numbers say it, and it is asked about.

As many columns as the robot has joints are taken together: numbered ones, ones that end in letters
from A on, and, where names show no such series, any that stand at even distances. Positions are
within the limits; their rate of change, and the torque that moves and holds the described arm
along them, tell the others, and which joint is which. What a name calls a goal, a target or the
like, and what positions follow, are their set-points.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.logs.readers.columns import (
    COMMAND,
    COMMANDED,
    CURRENT,
    NOTHING,
    PLAIN,
    POSITION,
    TIME,
    TORQUE,
    VELOCITY,
    ColumnFamily,
    Name,
    read_name,
)
from limo_driver.logs.readers.proposals.column_numbers import ColumnNumbers, are_apart, in_order
from limo_driver.logs.readers.proposals.times import time_columns, time_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.logs.readers.proposals.times import TimeFound
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel

_COUNTED: Final = re.compile(r"column_\d+")
_LETTERED: Final = re.compile(r"(.+?)[ _.-]?([A-Za-z])")
_MOST: Final = 48  # columns that are looked at
_EVEN: Final = 0.5  # of the usual step, within which nearly all steps of a time are
_NEARLY_ALL: Final = 0.9
_RUN: Final = 50_000  # rows without a gap that are differentiated


@dataclass
class ByNumbers:
    """What columns may be of which no name says it."""

    time: TimeFound
    families: list[ColumnFamily]
    found: dict[str, ColumnFamily] = field(default_factory=dict)  # by quantity
    why: list[str] = field(default_factory=list)

    @property
    def question(self) -> str:
        """What has to be asked; empty where names say it all."""
        if not self.found:
            return ""
        counted = [f"{TIME}: {x}" for x in self.time.columns.columns if _COUNTED.fullmatch(x)]
        named = (f"{quantity}: {_listed(family)}" for quantity, family in self.found.items())
        listed = "; ".join((*counted, *named))
        because = f" ({', '.join(self.why)})" if self.why else ""
        return (
            f"columns: no name says what they are: is it {listed}, in the order of the "
            f"joints{because}?"
        )

    def take(
        self, quantity: str, family: ColumnFamily, why: str = "", *, called: str = ""
    ) -> ColumnFamily:
        """Take columns for a quantity, asked about under another name where it is `called` so."""
        names = tuple(replace(name, quantity=quantity, family=()) for name in family.names)
        rank = COMMANDED if called else family.rank
        taken = replace(family, quantity=quantity, rank=rank, names=names)
        self.found[called or quantity] = taken
        others = (other for other in self.families if {*other.columns} != {*family.columns})
        self.families = [*others, taken]
        self.why += [why] if why else []
        return taken


def families_by_numbers(
    table: LogTable, families: Sequence[ColumnFamily], model: RobotModel
) -> ByNumbers:
    """Return the columns of joints, also those of which their numbers alone say what they are.

    Args:
        table: What the log holds.
        families: What names say.
        model: The robot.
    """
    counted = all(map(_COUNTED.fullmatch, table.columns))
    time = (_counted_time(table) if counted else None) or time_columns(table)
    result = ByNumbers(time, [] if counted else [*families, *_lettered(table, model.n)])
    whole = [f for f in result.families if len(f.names) == model.n and not f.missing]
    named = {f.quantity: f for f in reversed(whole)}
    has_torque = not named.keys().isdisjoint({TORQUE, CURRENT})
    if POSITION in named and has_torque:
        return result
    known = {*time.columns.columns, *(c for f in whole if f.quantity for c in f.columns)}
    loose = _loose(table, known, model.joint_names)
    series = [f for f in whole if f.quantity == NOTHING]
    layouts = [series] if series else _layouts(loose, model.n)
    is_filled = counted and bool(layouts) and len(loose) % model.n == 0
    both = POSITION not in named
    numbers = ColumnNumbers(table, time, model, sure=bool(series), both=both)
    others = [f for f in whole if f.quantity in {TORQUE, VELOCITY}]
    position = named.get(POSITION) or numbers.position(layouts, others)
    if position is None and not is_filled:
        return result
    position = position or layouts[0][0]
    left = [f for groups in layouts for f in groups if are_apart(f, position)]
    goals = next((f for f in left if numbers.is_followed(f, position)), None)
    if goals is not None and both and numbers.ahead(goals, position) < 0:
        position, goals = goals, position
    rate = numbers.velocity(left, position)
    taken = [f for f in (position, goals, rate) if f is not None]
    left = [f for f in left if all(are_apart(f, other) for other in taken)]
    left = [f for f in left if not numbers.is_scaled(f, position)]
    torque = None if has_torque else numbers.torque(left, position)
    why, order = "the described arm has such torques in these positions", tuple(range(model.n))
    if torque is not None:
        order = numbers.order(torque, position)
        why += "" if [*order] == sorted(order) else ", of which the numbers are not in their order"
    elif is_filled and not has_torque and len(loose) == 2 * model.n and left:
        torque, why = left[0], ""
    own = order if both else tuple(range(model.n))
    if both:
        result.take(POSITION, in_order(position, own))
    if goals is not None:
        result.take(POSITION, in_order(goals, own), "the positions follow them", called=COMMAND)
    if rate is not None and VELOCITY not in named:
        result.take(VELOCITY, in_order(rate, own), "the one is the rate of change of the other")
    if torque is not None:
        result.take(TORQUE, in_order(torque, order), why)
    return result


def _listed(family: ColumnFamily) -> str:
    """Return the columns of a family, each of them where their numbers do not go on by one."""
    ends = [int(numbers[-1]) for x in family.columns if (numbers := re.findall(r"\d+", x))]
    is_row = all(b - a == 1 for a, b in pairwise(ends))
    return str(family) if is_row else ", ".join(family.columns)


def _family(columns: Sequence[str]) -> ColumnFamily:
    names = (Name(c, NOTHING, PLAIN, k, "", ()) for k, c in enumerate(columns, start=1))
    return ColumnFamily(NOTHING, PLAIN, tuple(names))


def _counted_time(table: LogTable) -> TimeFound | None:
    """Return the time among columns without names: one that runs evenly, and counts no rows."""
    even = [name for name, values in table.columns.items() if _runs_evenly(values)]
    if not even:
        return None
    found = time_in(table, next((x for x in even if not _counts(table.columns[x])), even[0]))
    return replace(found, why=f"it runs evenly; {found.why}")


def _runs_evenly(values: NDArray[np.generic]) -> bool:
    if values.dtype.kind not in "fiu":
        return False
    steps = np.diff(values.astype(np.float64))
    usual = float(np.median(steps)) if steps.size else 0.0
    return usual > 0 and bool((np.abs(steps - usual) < _EVEN * usual).mean() > _NEARLY_ALL)


def _counts(values: NDArray[np.generic]) -> bool:
    return float(np.median(np.diff(values.astype(np.float64)))) == 1.0


def _lettered(table: LogTable, joints: int) -> list[ColumnFamily]:
    """Return columns that are alike but for letters from A on at their ends."""
    series = defaultdict[tuple[str, bool], dict[str, str]](dict)
    for column in table.columns:
        if found := _LETTERED.fullmatch(column):
            series[found[1], found[2].isupper()][found[2].lower()] = column
    wanted = [chr(ord("a") + k) for k in range(min(joints, 26))]
    return [_family([own[x] for x in wanted]) for own in series.values() if [*own] == wanted]


def _loose(table: LogTable, known: set[str], joints: Sequence[str]) -> list[str]:
    """Return columns of numbers that change, of which no name says what they are."""
    return [
        name
        for name, values in table.columns.items()
        if values.dtype.kind in "fiu"
        and name not in known
        and read_name(name, joints).quantity == NOTHING
        and not _runs_evenly(values)
        and np.unique(values[np.isfinite(values)][:_RUN]).size > 1
    ]


def _layouts(columns: Sequence[str], joints: int) -> list[list[ColumnFamily]]:
    """Return by their distance what may be columns of one quantity: side by side, every third."""
    if len(columns) > _MOST:
        return []
    strides = range(1, (len(columns) // joints if joints > 1 else 1) + 1)
    return [
        [
            _family(columns[a : a + stride * joints : stride])
            for a in range(len(columns) - stride * (joints - 1))
        ]
        for stride in strides
    ]
