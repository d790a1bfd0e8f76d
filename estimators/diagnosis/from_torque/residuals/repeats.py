"""Repeats: recordings of one motion, and what their torques differ by.

A motion that is recorded again asks the same of the arm. What torques differ by beside it is noise,
and what changed in the arm between the two: a bound for what any simulation can reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import fminbound

from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.settings.residuals import REPEATS, ROWS
from estimators.diagnosis.wording import names_of, rounded

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Repeat:
    """Two recordings of one motion."""

    recordings: tuple[int, int]  # 0-based
    delay: float  # by which the motion is later in the second one's time [s]
    apart: FloatArray  # (n,) what their residuals differ by, over √2; NaN where still [N m]


def repeats(observed: Observations, left: FloatArray) -> tuple[Repeat, ...]:
    """Return the pairs of recordings that are of one motion.

    Args:
        observed: Recordings and simulation.
        left: Residual, (K, n) [N m]: what little the motions differ by is out of it.
    """
    pairs = combinations(range(len(observed.recordings)), 2)
    found = (_repeat(observed, left, *pair) for pair in pairs)
    return tuple(item for item in found if item is not None)


def notes(observed: Observations, left: FloatArray) -> Iterator[str]:
    """Yield which recordings repeat one motion and what they differ by, one sentence each."""
    names = names_of(observed.recordings)
    for item in repeats(observed, left):
        first, second = (names[k] for k in item.recordings)
        apart = ", ".join("-" if np.isnan(x) else rounded(x) for x in item.apart)
        yield (
            f"{first} and {second} repeat one motion. Beside what the motion explains, one torque "
            f"is {apart} N m RMS off (joint by joint): noise, and what changed in between."
        )


def _repeat(observed: Observations, left: FloatArray, first: int, second: int) -> Repeat | None:
    """Lay one recording over another; None if they are of different motions."""
    rows, others = (np.flatnonzero(observed.recording == k) for k in (first, second))
    if min(rows.size, others.size) < REPEATS.fewest:
        return None
    slow = observed.slow
    moves = np.sqrt(np.mean(slow.velocity[rows] ** 2, axis=0)) > ROWS.repeated
    moves |= np.sqrt(np.mean(slow.velocity[others] ** 2, axis=0)) > ROWS.repeated
    position, velocity, residual = (
        CubicSpline(slow.time[others], values[others])
        for values in (slow.position, slow.velocity, left)
    )

    def apart(delay: float) -> float:
        """Return the mean square by which positions differ where both are known [rad²]."""
        known = _known(observed, rows, others, delay)
        if known.sum() < REPEATS.least * rows.size:
            return np.inf
        there = slow.time[rows[known]] + delay
        return float(np.mean((position(there) - slow.position[rows[known]]) ** 2))

    coarse, period = _delay(observed, rows, others), observed.row_period
    best = fminbound(apart, coarse - 2 * period, coarse + 2 * period, xtol=REPEATS.exact)
    delay = float(np.asarray(best).item())
    if not moves.any() or np.sqrt(apart(delay)) > REPEATS.near:
        return None
    known = _known(observed, rows, others, delay)
    own, there = rows[known], slow.time[rows[known]] + delay
    off = np.sqrt(np.mean((velocity(there) - slow.velocity[own]) ** 2, axis=0))
    speed = np.sqrt(np.mean(slow.velocity[own] ** 2, axis=0))
    if (off > np.maximum(REPEATS.alike * speed, ROWS.repeated))[moves].any():
        return None
    near = np.clip(np.searchsorted(slow.time[others], there), 0, others.size - 1)
    moving = observed.moving[own] & observed.moving[others[near]]
    differ = rmse(left[own] - residual(there), moving) / np.sqrt(2.0)
    return Repeat((first, second), delay, np.where(moving.any(axis=0), differ, np.nan))


def _known(
    observed: Observations, rows: NDArray[np.int64], others: NDArray[np.int64], delay: float
) -> NDArray[np.bool_]:
    """Mark the rows (R,) at whose place in the motion the other recording has no gap."""
    time = observed.slow.time
    there = time[rows] + delay
    after = np.clip(np.searchsorted(time[others], there), 1, others.size - 1)
    whole = observed.segment[others[after]] == observed.segment[others[after - 1]]
    return whole & (there >= time[others[0]]) & (there <= time[others[-1]])


def _delay(observed: Observations, rows: NDArray[np.int64], others: NDArray[np.int64]) -> float:
    """Return how much later the motion is in the second recording's time, to a row [s]."""
    from scipy.signal import correlate, correlation_lags  # slow to import; few have a repeat

    time, speed = observed.slow.time, observed.slow.velocity
    period = observed.row_period
    parts = []
    for own in (rows, others):  # a recording with gaps has no even grid
        grid = np.arange(float(time[own[0]]), float(time[own[-1]]), period)
        parts.append(np.stack([np.interp(grid, time[own], x) for x in speed[own].T], axis=1))
    first, second = parts
    scale = np.maximum(np.sqrt(np.mean(first**2, axis=0)), ROWS.repeated)
    alike = sum(
        np.asarray(correlate(second[:, j] / scale[j], first[:, j] / scale[j], method="fft"))
        for j in range(observed.n)
    )
    lags = correlation_lags(len(second), len(first))
    return float(lags[int(np.argmax(alike))] * period + time[others[0]] - time[rows[0]])
