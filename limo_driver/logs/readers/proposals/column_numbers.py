"""What the values of a log's columns say of each other: rates of change, set-points, torques."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.logs.readers.columns import COMMANDED, POSITION, UNITS, ColumnFamily
from limo_driver.logs.readers.proposals.gravity import DECISIVE, mountings, usual
from limo_driver.logs.readers.proposals.motion_units import MARGIN
from limo_driver.recordings.bandwidth import bandwidth_at
from limo_driver.recordings.filters.differentiation import Derivatives, differentiate
from limo_driver.recordings.gate.held_values import even_runs

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.logs.readers.proposals.times import TimeFound
    from limo_driver.logs.readers.table import LogTable
    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_SWEEP: Final = 0.1  # [s] over which rates and changes are compared
_SAME: Final = 0.9  # correlation of rates with changes, of most joints
_RANGES: Final = 2.0  # times that of positions, at most, of set-points that they follow
_TWIN: Final = (0.99, 1.1)  # correlation and range of set-points that no name calls so
_LEADS: Final = 0.3  # correlation with the velocity, of how far set-points are ahead
_ORDERED: Final = 8  # joints, at most, of which other orders are tried
_PERIOD: Final = 0.01  # [s], for rows of which no column says the time
_BANDWIDTH: Final = 5.0  # [Hz], within which arms move
_FEWEST: Final = 50  # rows that say anything
_ROWS: Final = 400  # of them that are compared
_FOLDS: Final = 6  # parts of these rows, of which every other is predicted by the others
_SLOW: Final = 0.02  # of a usual speed, over which dry friction changes its sign
_ROUNDING: Final = 1e-6  # of the variance of a torque, below which none of it is explained
_RUN: Final = 50_000  # rows without a gap that are differentiated
_NEARLY_ALL: Final = 0.9


def in_order(family: ColumnFamily, order: Sequence[int]) -> ColumnFamily:
    """Return a family with its columns in another order, (n,)."""
    return replace(family, names=tuple(family.names[j] for j in order))


def are_apart(one: ColumnFamily, other: ColumnFamily) -> bool:
    """Say whether two families share no column."""
    return {*one.columns}.isdisjoint(other.columns)


class ColumnNumbers:
    """What the values of columns say of each other.

    Args:
        table: What the log holds.
        time: Its time.
        model: The robot.
        sure: Whether names show which columns belong together.
        both: Whether no name says which column of positions is which joint's.
    """

    def __init__(
        self, table: LogTable, time: TimeFound, model: RobotModel, *, sure: bool, both: bool
    ) -> None:
        self._model, self._both, self._sure = model, both, sure
        self._most = -DECISIVE * (1 if sure else 2)  # that is left of what is believed
        known = {
            name: values.astype(np.float64)
            for name, values in table.columns.items()
            if values.dtype.kind in "fiu" and np.isfinite(values).mean() > _NEARLY_ALL
        }
        self._place = {name: k for k, name in enumerate(known)}
        values = np.stack([*known.values()], axis=1) if known else np.zeros((table.rows, 0))
        clock = np.arange(table.rows, dtype=np.float64) * _PERIOD
        if not time.questions and time.columns.columns:
            clock = time.columns.read(table)[0]
        rows = np.flatnonzero(np.isfinite(clock) & np.isfinite(values).all(axis=1))
        run = max(even_runs(clock[rows]), key=lambda run: run.stop - run.start)
        rows = rows[run][:_RUN]
        self._values, self._time = values[rows], clock[rows]
        self._is_rate = self._rates()
        every = slice(None, None, max(1, rows.size // _ROWS))
        motion = self._motion()
        self._value, self._first, self._second = (
            x[every] for x in (motion.value, motion.first, motion.second)
        )

    def _motion(self) -> Derivatives:
        values, still = self._values, np.zeros_like(self._values)
        try:
            bandwidth = bandwidth_at((len(values) - 1) / float(np.ptp(self._time)), _BANDWIDTH)
            return differentiate(self._time, values, bandwidth, [slice(0, len(values))])
        except (RecordingError, ZeroDivisionError):  # too short, or too slow
            return Derivatives(values, still, still)

    def _rates(self) -> FloatArray:
        """Return the log of what columns leave of the changes of others, (changes, says)."""
        values, step = self._values, np.diff(self._time)
        every = max(1, round(_SWEEP / float(np.median(step)))) if step.size else 1
        swept = np.cumsum((values[1:] + values[:-1]) / 2 * step[:, None], axis=0)
        path = np.vstack([np.zeros_like(values[:1]), swept])
        says, does = (np.diff(x[::every], axis=0) for x in (path, values))
        size = np.sqrt(np.outer((does**2).sum(axis=0), (says**2).sum(axis=0)))
        same = np.maximum(does.T @ says / np.maximum(size, 1e-300), 0.0)
        return 0.5 * np.log(np.maximum(1 - same**2, _ROUNDING))

    def _columns(self, family: ColumnFamily) -> list[int]:
        return [self._place[name] for name in family.columns]

    def _has(self, family: ColumnFamily) -> bool:
        return self._place.keys() >= {*family.columns} and len(self._value) >= _FEWEST

    def position(
        self, layouts: Sequence[Sequence[ColumnFamily]], others: Sequence[ColumnFamily]
    ) -> ColumnFamily | None:
        """Return the columns that are most likely the positions; None if no number says so.

        Args:
            layouts: Columns that may be one quantity.
            others: That names say to be torques or velocities.
        """
        for model in mountings(self._model):
            scores = list[tuple[float, ColumnFamily]]()
            for group, around in ((f, [*groups, *others]) for groups in layouts for f in groups):
                if not self._has(group):
                    continue
                rest = [f for f in around if are_apart(f, group) and self._has(f)]
                gains = self._gains(rest, group, model)
                own = min((*gains, *(self.rate(f, group) for f in rest)), default=0.0)
                is_rate = min((self.rate(group, f) for f in rest), default=0.0)
                scores.append((own - is_rate, group))
            least, best = min(scores, key=lambda pair: pair[0], default=(0.0, None))
            if least < self._most:
                return best
        groups = [f for group in layouts for f in group if self._sure and self._has(f)]
        around = ((f, [other for other in groups if other is not f]) for f in groups)
        return next((f for f, rest in around if self._in_other_order(rest, f)), None)

    def _in_other_order(
        self, groups: Sequence[ColumnFamily], position: ColumnFamily
    ) -> ColumnFamily | None:
        """Return the columns that are torques if those of another joint stand at each number."""
        if self._model.n > _ORDERED or not (self._sure and self._has(position)):
            return None
        found = [self._best_order(f, position)[1] for f in groups]
        least = -DECISIVE - math.lgamma(self._model.n + 1)  # so many orders would do, too
        return groups[int(np.argmin(found))] if min(found, default=0.0) < least else None

    def torque(self, groups: Sequence[ColumnFamily], position: ColumnFamily) -> ColumnFamily | None:
        """Return the columns that are most likely torques or currents; None if none are."""
        groups = [f for f in groups if self._has(f)]
        for model in mountings(self._model):
            gains = self._gains(groups, position, model) if self._has(position) else []
            if min(gains, default=0.0) < self._most:
                self._model = model
                return groups[int(np.argmin(gains))]
        return self._in_other_order(groups, position)

    def order(self, torque: ColumnFamily, position: ColumnFamily) -> tuple[int, ...]:
        """Return which column is which joint's: as they stand, unless another order is far better.

        That of positions changes with that of torques, unless names say it.
        """
        best, least, as_is = self._best_order(torque, position)
        return best if least < as_is - 2 * DECISIVE else tuple(range(self._model.n))

    def _best_order(
        self, torque: ColumnFamily, position: ColumnFamily
    ) -> tuple[tuple[int, ...], float, float]:
        """Return the likeliest order, what it gains, and what the given one does."""
        n, known = self._model.n, dict[tuple[int, ...], float]()

        def gain(order: tuple[int, ...]) -> float:
            if order not in known:
                own = in_order(position, order) if self._both else position
                (known[order],) = self._gains([in_order(torque, order)], own, self._model)
            return known[order]

        best = tuple(range(n))
        as_is = gain(best)
        while n <= _ORDERED:
            near = [
                tuple({i: best[j], j: best[i]}.get(k, best[k]) for k in range(n))
                for i, j in combinations(range(n), 2)
            ]
            other = min(near, key=gain, default=best)
            if gain(other) >= gain(best):
                break
            best = other
        return best, gain(best), as_is

    def is_followed(self, goals: ColumnFamily, position: ColumnFamily) -> bool:
        """Say whether columns are set-points of positions, or these are theirs.

        Those that no name calls commanded have to be the same, but for a delay.
        """
        if not (self._has(goals) and self._has(position)):
            return False
        both = np.stack([self._value[:, self._columns(f)].T for f in (goals, position)], axis=1)
        both = both[(np.ptp(both, axis=2) > 0).all(axis=1)]
        if not both.size:
            return False
        wider = float(np.median(np.diff(np.log(np.ptp(both, axis=2)))))
        alike = np.median([np.corrcoef(joint)[0, 1] for joint in both])
        if goals.rank != COMMANDED:
            is_same = alike > _TWIN[0] and abs(wider) < math.log(_TWIN[1])
            return bool(is_same and abs(self.ahead(goals, position)) > _LEADS)
        units = (0.0, math.log(math.degrees(1.0)), -math.log(math.degrees(1.0)))
        return min(abs(wider - unit) for unit in units) < math.log(_RANGES) and alike > _SAME

    def is_scaled(self, group: ColumnFamily, position: ColumnFamily) -> bool:
        """Say whether columns are positions in another unit, or before a gear."""
        if not (self._has(group) and self._has(position)):
            return False
        one, other = (self._value[:, self._columns(f)] for f in (group, position))
        pairs = (np.corrcoef(*pair) for pair in zip(one.T, other.T, strict=True))
        return min(abs(float(pair[0, 1])) for pair in pairs) > _TWIN[0]

    def ahead(self, goals: ColumnFamily, position: ColumnFamily) -> float:
        """Return the correlation with their speed, of how far goals are beyond positions."""
        own, other = self._columns(position), self._columns(goals)
        beyond, speed = self._value[:, other] - self._value[:, own], self._first[:, own]
        size = np.sqrt((beyond**2).sum(axis=0) * (speed**2).sum(axis=0))
        return float(np.median((beyond * speed).sum(axis=0) / np.maximum(size, 1e-300)))

    def rate(self, rate: ColumnFamily, position: ColumnFamily) -> float:
        """Return the sum of logs of what columns leave of changes; 0 of what are no rates."""
        if not (self._has(rate) and self._has(position)):
            return 0.0
        left = self._is_rate[self._columns(position), self._columns(rate)]
        left = left[np.ptp(self._values[:, self._columns(position)], axis=0) > 0]
        is_rate = left.size and left.mean() < 0.5 * math.log(1 - _SAME**2)
        return float(left.sum()) if is_rate else 0.0

    def velocity(
        self, groups: Sequence[ColumnFamily], position: ColumnFamily
    ) -> ColumnFamily | None:
        """Return the columns that are the rates of change of positions; None if none are."""
        best = min(groups, key=lambda f: self.rate(f, position), default=None)
        if best is None or not self._has(best):
            return None
        (torque,) = self._gains([best], position, self._model)
        return best if self.rate(best, position) < min(-DECISIVE, torque) else None

    def _gains(
        self, torques: Sequence[ColumnFamily], position: ColumnFamily, model: RobotModel
    ) -> list[float]:
        """Return what each of some columns has left of it if they are torques at positions.

        That is the sum over joints of log(what the described arm leaves of a torque / what it
        leaves of it without weight and inertia), each of rows that are predicted from others.
        """
        if model.massless or not torques:
            return [0.0] * len(torques)
        every = [
            self._gains_in(unit, torques, position, model)
            for unit in ("rad", "deg")
            if self._is_within(self._columns(position), unit)
        ]
        return np.min(every, axis=0).tolist() if every else [0.0] * len(torques)

    def _is_within(self, columns: Sequence[int], unit: str) -> bool:
        """Say whether columns are within the limits of some joint each, whichever it is."""
        turns = ~np.array(self._model.sliding)
        if not turns.any():
            return True
        low, high = np.nanquantile(self._values[:, columns][:, turns], (0.002, 0.998))
        scale, limits = UNITS[POSITION][unit], self._model.limits
        most = limits.position_max[turns].max(), -limits.position_min[turns].min()
        return bool(high * scale < most[0] + MARGIN and -low * scale < most[1] + MARGIN)

    def _gains_in(
        self, unit: str, torques: Sequence[ColumnFamily], position: ColumnFamily, model: RobotModel
    ) -> list[float]:
        own = self._columns(position)
        scale = np.where(model.sliding, 1.0, UNITS[POSITION][unit])
        q, v, a = (x[:, own] * scale for x in (self._value, self._first, self._second))
        rows = usual(np.hstack([v, a]))
        q, v, a = q[rows], v[rows], a[rows]
        load = model.gravity_torque(q)
        inertia = model.inverse_dynamics(q, v, a) - load
        side = np.tanh(v / (_SLOW * np.maximum(v.std(axis=0), 1e-12)))
        gains = np.zeros(len(torques))
        for j in range(model.n):
            b = self._value[rows][:, [self._columns(f)[j] for f in torques]]
            without = np.stack([np.ones(len(q)), side[:, j], v[:, j], a[:, j]], axis=1)
            arm = np.column_stack([without, load[:, j], inertia[:, j]])
            least = _ROUNDING * b.var(axis=0) + 1e-300
            gains += 0.5 * np.log((_left(arm, b) + least) / (_left(without, b) + least))
        return gains.tolist()


def _left(known: FloatArray, b: FloatArray) -> FloatArray:
    """Return the mean square that a fit leaves of columns b (T, k) in rows that it has not seen."""
    A = known / np.maximum(np.abs(known).max(axis=0), 1e-12)
    part = np.arange(len(A)) * _FOLDS // len(A) % 2
    left = np.zeros(b.shape[1])
    for seen in (part == 0, part == 1):
        x = np.linalg.lstsq(A[seen], b[seen], rcond=1e-9)[0]
        left += ((b[~seen] - A[~seen] @ x) ** 2).sum(axis=0)
    return left / len(A)
