"""Columns of which no name says what they are: their numbers say it, and it is asked about.

As many columns as the robot has joints are taken together: numbered ones, ones that end in letters
from A on, and, where no column has a name, one block after the other. Positions are within the
limits; their rate of change, and the gravity torque of the arm in them, tell the others. What a
name calls a goal, a target or the like, and what positions follow, are their set-points.
"""

from __future__ import annotations

import math
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
)
from limo_driver.logs.readers.proposals.gravity import DECISIVE, Gravity, some_rows
from limo_driver.logs.readers.proposals.motion_units import within_limits
from limo_driver.logs.readers.proposals.times import time_columns, time_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.logs.readers.proposals.times import TimeFound
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_COUNTED: Final = re.compile(r"column_\d+")
_LETTERED: Final = re.compile(r"(.+?)[ _.-]?([A-Za-z])")
_MOST: Final = 8  # groups of columns that are looked at
_SWEEP: Final = 0.1  # [s] over which rates and changes are compared
_SAME: Final = 0.9  # correlation of rates with changes, of most joints
_RANGES: Final = 2.0  # times that of positions, at most, of set-points that they follow
_EVEN: Final = 0.5  # of the usual step, within which nearly all steps of a time are
_NEARLY_ALL: Final = 0.9


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
        named = (f"{quantity}: {family}" for quantity, family in self.found.items())
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
        self.found[called or quantity] = taken = replace(family, quantity=quantity, names=names)
        self.families = [*(other for other in self.families if other is not family), taken]
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
    blocks = _blocks(table, model.n)
    if blocks is not None:
        time, groups = blocks
        result = ByNumbers(time, list(groups))
    else:
        result = ByNumbers(time_columns(table), [*families, *_lettered(table, model.n)])
        groups = [f for f in result.families if f.quantity == NOTHING and _is_whole(f, model.n)]
    named = {f.quantity for f in families if _is_whole(f, model.n)}
    lacks_torque = named.isdisjoint({TORQUE, CURRENT})
    if not groups or not (lacks_torque or POSITION not in named):
        return result
    numbers = _Numbers(table, result.time, model)
    left = list(groups[:_MOST])
    if POSITION not in named:
        others = [f for f in families if f.quantity in {TORQUE, VELOCITY}]
        position = numbers.position(left, others)
        if position is None and blocks is None:
            return result
        position = position or left[0]
        left.remove(position)
        position = result.take(POSITION, position)
    else:
        position = next(f for f in families if f.quantity == POSITION and _is_whole(f, model.n))
    goals = next((f for f in left if numbers.is_followed(f, position)), None)
    if goals is not None:
        left.remove(goals)
        result.take(POSITION, goals, "the positions follow them", called=COMMAND)
    rate = next((f for f in left if numbers.is_rate(f, position)), None)
    if rate is not None and VELOCITY not in named:
        left.remove(rate)
        result.take(VELOCITY, rate, "the one is the rate of change of the other")
    if lacks_torque and left:
        torque = min(left, key=lambda family: numbers.gravity(family, position))
        if numbers.gravity(torque, position) < -DECISIVE:
            result.take(TORQUE, torque, "gravity makes such torques in these positions")
        elif blocks is not None and len(left) == 1:
            result.take(TORQUE, torque)
    return result


def _is_whole(family: ColumnFamily, joints: int) -> bool:
    return len(family.names) == joints and not family.missing


def _family(columns: Sequence[str]) -> ColumnFamily:
    names = (Name(c, NOTHING, PLAIN, k, "", ()) for k, c in enumerate(columns, start=1))
    return ColumnFamily(NOTHING, PLAIN, tuple(names))


def _blocks(table: LogTable, joints: int) -> tuple[TimeFound, list[ColumnFamily]] | None:
    """Return the time and the blocks of columns without names; None if they have any."""
    names = list(table.columns)
    if len(names) < 2 or not all(map(_COUNTED.fullmatch, names)):  # noqa: PLR2004
        return None
    first, *others = names
    if len(others) % joints or not _runs_evenly(table.columns[first]):
        return None
    found = time_in(table, first)
    cuts = pairwise(range(0, len(others) + 1, joints))
    return (
        replace(found, why=f"it runs evenly; {found.why}"),
        [_family(others[a:b]) for a, b in cuts],
    )


def _runs_evenly(values: NDArray[np.generic]) -> bool:
    if values.dtype.kind not in "fiu":
        return False
    steps = np.diff(values.astype(np.float64))
    usual = float(np.median(steps)) if steps.size else 0.0
    return usual > 0 and bool((np.abs(steps - usual) < _EVEN * usual).mean() > _NEARLY_ALL)


def _lettered(table: LogTable, joints: int) -> list[ColumnFamily]:
    """Return columns that are alike but for letters from A on at their ends."""
    series = defaultdict[tuple[str, bool], dict[str, str]](dict)
    for column in table.columns:
        if found := _LETTERED.fullmatch(column):
            series[found[1], found[2].isupper()][found[2].lower()] = column
    wanted = [chr(ord("a") + k) for k in range(min(joints, 26))]
    return [_family([own[x] for x in wanted]) for own in series.values() if [*own] == wanted]


class _Numbers:
    """What the values of columns say of each other."""

    def __init__(self, table: LogTable, time: TimeFound, model: RobotModel) -> None:
        self._table, self._model = table, model
        self._time = None if time.questions else time.columns.read(table)[0]

    def _values(self, family: ColumnFamily) -> FloatArray:
        own = [self._table.columns[name] for name in family.columns]
        return np.stack(own, axis=1).astype(np.float64)

    def position(
        self, groups: Sequence[ColumnFamily], others: Sequence[ColumnFamily]
    ) -> ColumnFamily | None:
        """Return the group that is most likely the positions; None if no number says so."""
        scores = dict[int, float]()
        for k, group in enumerate(groups):
            if not self._units(group):
                continue
            rest = [other for other in (*groups, *others) if other is not group]
            has_rate = any(self.is_rate(other, group) for other in rest)
            least = min((self.gravity(other, group) for other in rest), default=0.0)
            scores[k] = least - 10 * DECISIVE * has_rate
        best = min(scores, key=lambda k: scores[k], default=None)
        return groups[best] if best is not None and scores[best] < -DECISIVE else None

    def _units(self, group: ColumnFamily) -> list[str]:
        """Return the units in which a group may be positions."""
        values = self._values(group)
        known = values[np.isfinite(values).all(axis=1)]
        return [unit for unit in ("rad", "deg") if within_limits(known, unit, self._model)]

    def is_followed(self, goals: ColumnFamily, position: ColumnFamily) -> bool:
        """Say whether a group that its names call commanded has set-points of positions."""
        if goals.rank != COMMANDED:
            return False
        both = np.stack([self._values(goals).T, self._values(position).T], axis=1)  # (n, 2, T)
        both = both[..., np.isfinite(both).all(axis=(0, 1))]
        both = both[(np.ptp(both, axis=2) > 0).all(axis=1)] if both.size else both
        if not both.size:
            return False
        wider = float(np.median(np.diff(np.log(np.ptp(both, axis=2)))))
        units = (0.0, math.log(math.degrees(1.0)), -math.log(math.degrees(1.0)))
        alike = np.median([np.corrcoef(joint)[0, 1] for joint in both])
        return min(abs(wider - unit) for unit in units) < math.log(_RANGES) and alike > _SAME

    def is_rate(self, rate: ColumnFamily, position: ColumnFamily) -> bool:
        """Say whether one group is the rate of change of another."""
        if self._time is None or len(rate.names) != len(position.names):
            return False
        rows = np.append(True, np.diff(self._time) > 0) & np.isfinite(self._time)
        time, rates, places = (
            self._time[rows],
            self._values(rate)[rows],
            self._values(position)[rows],
        )
        step = np.diff(time)
        every = max(1, round(_SWEEP / float(np.median(step))))
        path = np.vstack(
            [0 * rates[:1], np.cumsum((rates[1:] + rates[:-1]) / 2 * step[:, None], 0)]
        )
        says, does = (np.diff(x[::every], axis=0) for x in (path, places))
        together = (says * does).sum(axis=0)
        size = np.sqrt((says**2).sum(axis=0) * (does**2).sum(axis=0))
        moving = size > 0
        return bool(moving.any() and np.median(together[moving] / size[moving]) > _SAME)

    def gravity(self, torque: ColumnFamily, position: ColumnFamily) -> float:
        """Return what gravity leaves of one group in the positions of another; less is better."""
        if len(torque.names) != self._model.n:
            return 0.0
        places, torques = self._values(position), self._values(torque)
        rows = some_rows(places, torques)
        cost = Gravity(self._model, torques[rows])
        every = (cost.of(places[rows], (unit,) * self._model.n) for unit in self._units(position))
        return min(every, default=0.0)
