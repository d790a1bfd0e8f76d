"""Repeats: recordings of one motion, of which each foretells the others' residual.

What a motion makes of an arm comes again when the motion does; noise does not. So what repeats
differ by is their noise floor, whatever a black box can make of the motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import correlate, correlation_lags

from estimators.diagnosis.observations import REST
from estimators.diagnosis.wording import names_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.observations import Observations
    from limo_driver.types import FloatArray

ALIKE = 0.05  # of a joint's RMS speed, by which the speeds of repeats may differ
_LEAST = 0.5  # of the rows of a recording, that have to be in the other one
_FINER = 11  # lags tried within a row of the best one, either side


@dataclass(frozen=True)
class _Pair:
    """Rows of a recording, and the rows around the same places of the motion in another one."""

    rows: NDArray[np.int64]  # (R,) kept rows of the first
    others: NDArray[np.int64]  # (S,) kept rows of the second, a stretch
    time: FloatArray  # (R,) where the second one is as far in the motion [s]
    known: NDArray[np.bool_]  # (R,) where the second one has no gap there


def foretold_by_repeats(
    observed: Observations, left: FloatArray
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return what other recordings of the same motion foretell of a residual.

    Args:
        observed: Recordings and simulation.
        left: Residual, (K, n) [N m].

    Returns:
        Mean residual of the others at the same place of the motion, (K, n) [N m], and the number of
        others, (K,); both are zero where there is none.
    """
    total, count = np.zeros_like(left), np.zeros(left.shape[0], dtype=np.int64)
    for pair in _pairs(observed):
        values = _read(observed, left, pair)
        total[pair.rows[pair.known]] += values[pair.known]
        count[pair.rows[pair.known]] += 1
    return total / np.maximum(count, 1)[:, None], count


def groups(observed: Observations) -> tuple[tuple[int, ...], ...]:
    """Return which recordings (0-based) repeat one motion, the first ones first."""
    alike: dict[int, set[int]] = {}
    for pair in _pairs(observed):
        a, b = (int(observed.recording[rows[0]]) for rows in (pair.rows, pair.others))
        whole = alike.get(a, {a}) | alike.get(b, {b})
        alike |= dict.fromkeys(whole, whole)
    return tuple(sorted({tuple(sorted(whole)) for whole in alike.values()}))


def notes(observed: Observations) -> Iterator[str]:
    """Yield which recordings repeat one motion, one sentence each."""
    names = names_of(observed.recordings)
    for group in groups(observed):
        *some, last = (names[k] for k in group)
        yield f"{', '.join(some)} and {last} repeat one motion; what comes again is not noise."


def _pairs(observed: Observations) -> Sequence[_Pair]:
    found = []
    for a, b in permutations(range(len(observed.recordings)), 2):
        rows, others = (np.flatnonzero(observed.recording == k) for k in (a, b))
        pair = _paired(observed, rows, others)
        if pair is not None:
            found.append(pair)
    return found


def _paired(
    observed: Observations, rows: NDArray[np.int64], others: NDArray[np.int64]
) -> _Pair | None:
    """Lay one recording over another; None if they are of different motions."""
    time, speed = observed.slow.time, observed.slow.velocity
    if min(rows.size, others.size) < 2 / _LEAST:
        return None
    spline = CubicSpline(time[others], speed[others])
    scale = np.sqrt(np.mean(speed[rows] ** 2, axis=0))
    moves = scale > REST
    if not moves.any():
        return None

    def laid_over(delay: float) -> tuple[float, NDArray[np.bool_]]:
        """Return by how much speeds differ at worst [RMS speeds], and where both are known."""
        there = time[rows] + delay
        after = np.clip(np.searchsorted(time[others], there), 1, others.size - 1)
        known = observed.segment[others[after]] == observed.segment[others[after - 1]]
        known &= (there >= time[others[0]]) & (there <= time[others[-1]])
        if known.sum() < _LEAST * rows.size:
            return np.inf, known
        apart = (spline(there[known]) - speed[rows[known]])[:, moves]
        return float((np.sqrt(np.mean(apart**2, axis=0)) / scale[moves]).max()), known

    coarse = _delay(observed, rows, others)
    near = coarse + observed.row_period * np.linspace(-1.0, 1.0, 2 * _FINER + 1)
    delay = min(near.tolist(), key=lambda x: laid_over(x)[0])
    apart, known = laid_over(delay)
    return _Pair(rows, others, time[rows] + delay, known) if apart <= ALIKE else None


def _delay(observed: Observations, rows: NDArray[np.int64], others: NDArray[np.int64]) -> float:
    """Return how much later than the first the second recording is, to a row [s]."""
    time, speed = observed.slow.time, observed.slow.velocity
    period = observed.row_period
    parts = []
    for own in (rows, others):  # a recording with gaps has no even grid
        grid = np.arange(float(time[own[0]]), float(time[own[-1]]), period)
        parts.append(np.stack([np.interp(grid, time[own], x) for x in speed[own].T], axis=1))
    first, second = parts
    scale = np.maximum(np.sqrt(np.mean(first**2, axis=0)), 1e-9)
    alike = sum(
        np.asarray(correlate(second[:, j] / scale[j], first[:, j] / scale[j], method="fft"))
        for j in range(observed.n)
    )
    lags = correlation_lags(len(second), len(first))
    return float(lags[int(np.argmax(alike))] * period + time[others[0]] - time[rows[0]])


def _read(observed: Observations, left: FloatArray, pair: _Pair) -> FloatArray:
    """Return the second recording's residual at the places of the first's rows, (R, n) [N m]."""
    spline = CubicSpline(observed.slow.time[pair.others], left[pair.others])
    return np.asarray(spline(np.clip(pair.time, *observed.slow.time[pair.others[[0, -1]]])))
