"""The clock of a recording, what is odd about its rows, and what was left out of it.

A stamp that is late by a few periods belongs to a message that was overtaken on its way. A clock
that is set goes on from another time, while the arm moves on as if nothing had happened: there the
time is cut, and a gap put there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from limo_driver.recordings.channels import VELOCITY, Columns, commanded_by, of_numbers
from limo_driver.recordings.gate.held_values import (
    LEAST_JUMP,
    contiguous,
    even_runs,
    held_torque,
    longest_step,
    one_factor,
    velocity_factors,
)
from limo_driver.types import BoolArray, FloatArray, IntArray

SYSTEMATIC: Final = 0.02  # share of rows above which a fault is no accident
_GAP: Final = 2.0  # times the longest step that is none, put where a clock was set
_OVERTAKEN: Final = 20  # periods, by which a message may come late
_HOLE: Final = 1.5  # periods, that messages are apart between which one is missing
FEWEST_LATE: Final = 3  # rows behind a step back; fewer are stamps out of place
_FEWEST: Final = 10  # rows of even progress, of which a piece of a recording has more
_NEAR: Final = 5  # rows on either side of a step, whose motion is that of the arm
_FASTER: Final = 3.0  # times that motion, that it may be within a period
_FARTHER: Final = 10.0  # times as far as it went, that it would have gone in the time of a step


def in_order(stamps: IntArray) -> tuple[IntArray, int]:
    """Return the rows in the order of their stamps, and how many were overtaken on their way.

    Moved are stamps that are late by a few periods and fill a hole. All others stay where they are:
    they are wrong, or of a clock that was set.

    Args:
        stamps: In the order in which they were logged, (T,) [ns].
    """
    every = np.arange(stamps.size)
    late = np.append(False, stamps[1:] < np.maximum.accumulate(stamps)[:-1])[: stamps.size]
    if not late.any():
        return every, 0
    rows, on_time = np.flatnonzero(late), every[~late]
    known = stamps[on_time]
    period = float(np.median(np.diff(known))) if known.size > 1 else 0.0
    after = np.searchsorted(known, stamps[rows], side="right").clip(1, max(known.size - 1, 1))
    hole = (known[np.minimum(after, known.size - 1)] - known[after - 1]) > _HOLE * period
    lateness = np.maximum.accumulate(stamps)[rows] - stamps[rows]
    moved = hole & (lateness <= _OVERTAKEN * period) & (stamps[rows] > known[after - 1])
    place = every.astype(np.float64)
    place[rows[moved]] = on_time[after[moved] - 1] + 0.5
    return np.lexsort((stamps, place)), int(moved.sum())


def runs_backwards(time: IntArray | FloatArray) -> float:
    """Return the share of rows at which a time goes back."""
    return float(np.mean(np.diff(time) < 0)) if time.size > 1 else 0.0


@dataclass(frozen=True)
class ClockStep:
    """Where a clock was set while the arm moved on."""

    row: int  # 0-based, the first that it stamped
    amount: float  # [s], forward
    gap: float  # [s], that stands there instead

    def __str__(self) -> str:
        """Say what was done about it."""
        way = "back" if self.amount < 0 else "forward"
        return (
            f"the clock was set {way} by {abs(self.amount):.4g} s at row {self.row}, while the "
            f"arm moved on: cut there, with a gap of {self.gap:.3g} s"
        )


def with_one_clock(columns: Columns) -> Columns:
    """Return the same with a time that goes on after a gap where the clock was set, and say so."""
    return OneClock().taken(columns)


class OneClock:
    """The clock of a recording that comes block by block, and where it was set (`steps`)."""

    def __init__(self) -> None:
        self.steps: list[ClockStep] = []
        self._shift = 0.0  # [s]
        self._rows = 0  # of the blocks before
        self._began: float | None = None  # [s], since when the clock was not set
        self._before: Columns | None = None  # the last rows of the block before

    def taken(self, columns: Columns) -> Columns:
        """Return what comes next with a time that goes on, and say where it was cut."""
        columns = of_numbers(columns)
        time, position = columns.time + self._shift, columns.position
        before = 0
        if self._before is not None:
            before = self._before.time.size
            time = np.concatenate([self._before.time, time])
            position = np.concatenate([self._before.position, position])
        if self._began is None:
            known = time[np.isfinite(time)]
            self._began = float(known[0]) if known.size else None
        steps = _steps(time, position, self._began or 0.0)
        found, put = list[ClockStep](), time.copy()
        for last, first, amount in steps:
            gap = _GAP * longest_step(np.diff(time))
            shift = put[last] + gap - put[first]
            put[first:] += shift
            self._shift += shift
            self._began = float(put[first])
            found.append(ClockStep(self._rows + first - before, amount, gap))
        kept = columns if not self._shift else replace(columns, time=put[before:])
        kept = replace(kept, warnings=(*kept.warnings, *map(str, found))) if found else kept
        self.steps += found
        self._rows += kept.time.size
        rows = slice(-4 * _FEWEST, None)
        self._before = replace(kept, time=kept.time[rows], position=kept.position[rows])
        return kept


def _steps(
    time: FloatArray, position: FloatArray, began: float
) -> Iterable[tuple[int, int, float]]:
    """Return the last row before and the first after each step of the clock, and its size [s].

    Args:
        time: (T,) [s], as recorded.
        position: (T, n) [rad], likewise.
        began: Since when the clock was not set [s]; a clock that starts again there is no step.
    """
    known = np.flatnonzero(np.isfinite(time))
    if known.size < 2 * _FEWEST or runs_backwards(time[known]) > SYSTEMATIC:
        return []
    forward = np.diff(time[known])
    period = float(np.median(forward[forward > 0])) if (forward > 0).any() else 0.0
    runs = [known[run] for run in even_runs(time[known]) if run.stop - run.start >= _FEWEST]
    found = list[tuple[int, int, float]]()
    for before, after in pairwise(runs):
        last, first = int(before[-1]), int(after[0])
        amount = float(time[first] - time[last]) - (first - last) * period
        if amount < 0:
            is_late = np.count_nonzero(time[after] <= time[last]) >= FEWEST_LATE
            is_restart = abs(time[first] - began) < FEWEST_LATE * period
            is_step = is_late and not is_restart and _goes_on(position, before, after)
        else:
            is_gap = amount > longest_step(forward)
            is_step = is_gap and _goes_on(position, before, after, amount / period)
        if is_step:
            found.append((last, first, amount))
            began = float(time[first])
    return found


def _goes_on(
    position: FloatArray, before: IntArray, after: IntArray, periods: float | None = None
) -> bool:
    """Say whether an arm moves on from one row to another as within a period.

    Args:
        position: (T, n) [rad].
        before: Rows up to the one.
        after: Rows from the other on.
        periods: For which it would have moved on else; some joint has to tell the difference.
    """
    with np.errstate(invalid="ignore"):
        own = [position[rows] for rows in (before[-_NEAR:], after[:_NEAR])]
        fastest = np.maximum(*(np.abs(np.diff(piece, axis=0)).max(axis=0) for piece in own))
        far = np.abs(own[1][0] - own[0][-1])
        goes_on = (far <= (after[0] - before[-1]) * _FASTER * fastest + LEAST_JUMP).all()
        if periods is None:
            return bool(goes_on)
        speeds = [(piece[-1] - piece[0]) / (len(piece) - 1) for piece in own]
        steady = np.where(speeds[0] * speeds[1] > 0, np.minimum(*np.abs(speeds)), 0.0)
        return bool(goes_on and (steady * periods > _FARTHER * np.maximum(far, LEAST_JUMP)).any())


STILL = 2e-3  # [rad], range of a joint that does not move
_FACTORS = (0.5, 2.0)  # of velocity to rate of change, that filters and noise may make
_TURNS = 4 * np.pi  # [rad]; few arms turn farther
_LISTED = 12  # stretches of rows that a message names
_MOSTLY: Final = 0.5  # of the rows in which a joint moves
_WITHIN: Final = 0.1  # [s], in which a joint that moves does so
_BY: Final = 1e-3  # [rad], beyond the noise of encoders
_FARTHEST: Final = 0.02  # [rad], that a joint at rest does not reach by the steps of its encoder


def doubts_about_rows(columns: Columns, rows: IntArray) -> tuple[str, ...]:
    """Return what is odd about rows that are kept, in a sentence each.

    Args:
        columns: Of the whole recording.
        rows: That can be used, (T,).
    """
    found: list[str] = []
    for quantity, values in columns.quantities().items():
        if holes := int((~np.isfinite(values[rows])).any(axis=1).sum()):
            found.append(f"{quantity} is missing in {holes} rows")
    return (
        *(() if columns.spread else about_gaps(columns.time[rows])),
        *_about_joints(columns, rows),
        *_about_velocity(columns, rows),
        *found,
    )


def _about_velocity(columns: Columns, rows: IntArray) -> list[str]:
    factors = velocity_factors(columns, rows)
    factor = one_factor(np.array(list(factors.values())))
    if factor is not None and len(factors) > 1:
        return [
            f"velocity is {factor:.3g} times the rate of change of position at all joints: does "
            f"the time run {factor:.3g} times as fast as it should? The velocity is not used"
        ]
    return [
        f"velocity_{j + 1} is {factor:.3g} times the rate of change of position_{j + 1}; "
        "it is not used"
        for j, factor in factors.items()
        if not _FACTORS[0] < factor < _FACTORS[1]
    ]


def about_gaps(time: FloatArray) -> list[str]:
    """Say how many gaps there are, and which is the longest.

    Args:
        time: Increasing, (T,) [s].
    """
    starts = [rows.start for rows in contiguous(time)[1:]]
    if not starts:
        return []
    lengths = [float(time[start] - time[start - 1]) for start in starts]
    worst = int(np.argmax(lengths))
    return [
        f"{len(starts)} gap{'s' * (len(starts) > 1)}; the longest, {lengths[worst]:.3g} s, "
        f"after {time[starts[worst] - 1]:.6g} s"
    ]


def _about_joints(columns: Columns, rows: IntArray) -> list[str]:
    found: list[str] = []
    turning = commanded_by(VELOCITY, columns.led)  # as wheels do, turn after turn
    for j in range(columns.position.shape[1]):
        position = columns.position[rows, j]
        torque = columns.torque[rows, j]
        if not turning[j] and (farthest := float(np.abs(position).max())) > _TURNS:
            found.append(
                f"position_{j + 1} reaches {farthest:.4g} rad, {farthest / (2 * np.pi):.3g} "
                "turns; is it in degrees?"
            )
        if np.ptp(position) < STILL:
            found.append(f"joint {j + 1} never moves (range {np.ptp(position):.2g} rad)")
        is_warned = any(known.startswith(f"torque_{j + 1} ") for known in columns.warnings)
        no_torque = columns.command is not None and torque[0] == 0
        if np.ptp(torque) == 0 and not (is_warned or no_torque):
            found.append(f"torque_{j + 1} is always {torque[0]:g} N m")
    return found


@dataclass(frozen=True)
class LeftOut:
    """Rows of a file that cannot be used."""

    reason: str
    rows: tuple[int, ...]  # 0-based rows of the file

    def __str__(self) -> str:
        """Name the rows, as `3 rows left out: a value is impossible (rows 1-2, 7)`."""
        rows = np.array(self.rows)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        listed = [f"{run[0]}" if run.size == 1 else f"{run[0]}-{run[-1]}" for run in runs]
        more = f" and {len(listed) - _LISTED} more stretches" if len(listed) > _LISTED else ""
        many = "s" * (rows.size > 1)
        return (
            f"{rows.size} row{many} left out: {self.reason} "
            f"(row{many} {', '.join(listed[:_LISTED])}{more})"
        )


@dataclass(frozen=True)
class UsableRows:
    """Usable rows, the rows left out by reason, and warnings about the others."""

    rows: IntArray  # (T,)
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]


def without_silent_torques(columns: Columns) -> Columns:
    """Return the same with 0 for torques that nobody measured, and say so.

    A column without a number is one. So is one that is 0, or at its limit, in most of the rows in
    which its joint moves, for longer than the noise of the others allows: a current within its dead
    band, or a sensor that can tell no more. The few rows between say when it wakes, and not what
    the joint feels.
    """
    if not np.isfinite(columns.torque).any():
        return columns
    reasons: dict[int, str] = {}  # by joint, 0-based
    every = zip(columns.position.T, columns.torque.T, strict=True)
    for j, (position, values) in enumerate(every):
        if not np.isfinite(values).any():
            reasons[j] = "is never measured; it is kept as 0"
        elif (held := _mostly(columns.time, position, values)) is not None:
            reasons[j] = (
                f"is {held[0] + 0.0:.4g} in {held[1]:.0%} of the rows in which its joint moves, "
                "and measures nothing; it is kept as 0"
            )
    if not reasons:
        return columns
    torque = np.array(columns.torque)
    torque[:, list(reasons)] = 0.0
    texts = (f"torque_{j + 1} {what}" for j, what in reasons.items())
    return replace(columns, torque=torque, warnings=(*columns.warnings, *texts))


def _mostly(
    time: FloatArray, position: FloatArray, torque: FloatArray
) -> tuple[float, float] | None:
    """Return the value that a torque has in most rows in motion, and in which part; None if none.

    Args:
        time: (T,) [s].
        position: (T,) [rad], of one joint.
        torque: (T,) [N m], of the same joint.
    """
    known = np.isfinite(time) & np.isfinite(position) & np.isfinite(torque)
    latest = np.maximum.accumulate(np.where(known, time, -np.inf))
    known[1:] &= time[1:] > latest[:-1]  # rows out of time are judged one by one, later
    time, position, torque = time[known], position[known], torque[known]
    if time.size < 2 or np.ptp(position) < _FARTHEST:  # noqa: PLR2004  # a rate takes two
        return None
    moves = _moves(time, position)
    if not moves.any():
        return None
    value = float(np.median(torque[moves]))  # that of more than half, if there is one
    part = float(np.mean(torque[moves] == value))
    if part <= _MOSTLY or value not in {0.0, float(torque.min()), float(torque.max())}:
        return None
    return (value, part) if held_torque(time, position, torque).any() else None


def _moves(time: FloatArray, position: FloatArray) -> BoolArray:
    """Mark the rows (T,) after which a joint moves."""
    ahead = max(1, round(_WITHIN / float(np.median(np.diff(time)))))
    moves = np.zeros(time.size, dtype=bool)
    moves[:-ahead] = np.abs(position[ahead:] - position[:-ahead]) > _BY
    return moves
