"""The clock of a recording: rows in the order of their stamps, and cuts where the clock was set.

A stamp that is late by a few periods belongs to a message that was overtaken on its way. A clock
that is set goes on from another time, while the arm moves on as if nothing had happened: there the
time is cut, and a gap put there.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.recordings.channels import of_numbers
from limo_driver.recordings.gate.held_values import LEAST_JUMP, even_runs, longest_step

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from limo_driver.recordings.channels import Columns
    from limo_driver.types import FloatArray

SYSTEMATIC: Final = 0.02  # share of rows above which a fault is no accident
_GAP: Final = 2.0  # times the longest step that is none, put where a clock was set
_OVERTAKEN: Final = 20  # periods, by which a message may come late
_HOLE: Final = 1.5  # periods, that messages are apart between which one is missing
FEWEST_LATE: Final = 3  # rows behind a step back; fewer are stamps out of place
_FEWEST: Final = 10  # rows of even progress, of which a piece of a recording has more
_NEAR: Final = 5  # rows on either side of a step, whose motion is that of the arm
_FASTER: Final = 3.0  # times that motion, that it may be within a period
_FARTHER: Final = 10.0  # times as far as it went, that it would have gone in the time of a step


def in_order(stamps: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
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


def runs_backwards(time: NDArray[np.int64] | FloatArray) -> float:
    """Return the share of rows at which a time goes back."""
    return float(np.mean(np.diff(time) < 0)) if time.size > 1 else 0.0


def with_one_clock(columns: Columns) -> Columns:
    """Return the same with a time that goes on after a gap where the clock was set, and say so."""
    return OneClock().taken(columns)


class OneClock:
    """The clock of a recording that comes block by block."""

    def __init__(self) -> None:
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
        notes, put = list[str](), time.copy()
        for last, first, amount in steps:
            gap = _GAP * longest_step(np.diff(time))
            shift = put[last] + gap - put[first]
            put[first:] += shift
            self._shift += shift
            self._began = float(put[first])
            way = "back" if amount < 0 else "forward"
            notes.append(
                f"the clock was set {way} by {abs(amount):.4g} s at row "
                f"{self._rows + first - before}, while "
                f"the arm moved on: cut there, with a gap of {gap:.3g} s"
            )
        kept = columns if not self._shift else replace(columns, time=put[before:])
        kept = replace(kept, warnings=(*kept.warnings, *notes)) if notes else kept
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
    position: FloatArray,
    before: NDArray[np.int64],
    after: NDArray[np.int64],
    periods: float | None = None,
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
