"""What of the recordings counts: joints that can be used, and motion that repeats itself.

Repeats: recordings of one motion, and what their torques differ by.

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

from estimators.base import WEIGHTLESS
from estimators.diagnosis.from_torque.residuals.mistakes import constant_joints, dry_and_viscous
from estimators.diagnosis.from_torque.residuals.noise import roughness
from estimators.diagnosis.headline import names_of
from estimators.diagnosis.held_out import rmse
from estimators.diagnosis.quantities import rounded
from estimators.diagnosis.settings import FINE, LITTLE, MOST, ROUNDING, SOME
from estimators.diagnosis.settings.residuals import MISTAKES, REPEATS, ROWS
from estimators.regression.evidence import REACH
from limo_driver.physics.effects.friction import SIGN_WIDTH

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import BoolArray, FloatArray, IntArray


def still(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) that move too little for their friction to show."""
    return tuple(np.flatnonzero(observed.moving.sum(axis=0) < MISTAKES.least_moving).tolist())


def holds_still(observed: Observations) -> bool:
    """Say whether the arm stays where it is in all recordings, while its encoders tell of it."""
    farthest = max(float(np.ptp(item.position, axis=0).max()) for item in observed.recordings)
    alive = len(constant_joints(observed)) < observed.n
    return alive and farthest < REPEATS.near and len(still(observed)) == observed.n


def doubtful_encoders(observed: Observations) -> tuple[int, ...]:
    """Return joints (0-based) that may move although their encoder gives one value.

    Nothing that the arm does moves the torque of a locked joint as far as this, and the mistake is
    not one that the torques of the others would show: they hardly depend on its position.
    """
    left = observed.measured - observed.filter(observed.load)
    left -= np.median(left, axis=0)
    torque = observed.measured - np.median(observed.measured, axis=0)
    rough = roughness(left, np.ones_like(observed.moving), observed.least_noise)
    strange = np.median(np.abs(left), axis=0)
    doubt = (strange > REACH * rough) & (strange > 0.5 * np.median(np.abs(torque), axis=0))
    return tuple(j for j in constant_joints(observed) if doubt[j])


def without_torque(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is one value in all rows."""
    return tuple(np.flatnonzero(np.ptp(observed.measured, axis=0) < ROUNDING).tolist())


def without_load(observed: Observations, least: float = WEIGHTLESS) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is next to nothing of what their load asks for.

    Where the load hardly changes, as that of a lift, no scale and no unit shows in its course.

    Args:
        observed: The recordings beside a simulation.
        least: Part of the load that a torque has to be.
    """
    load, torque = sizes(observed)
    light = np.flatnonzero(torque < least * load)
    silent = without_torque(observed)
    return tuple(j for j in light.tolist() if j not in silent)


def without_effort(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose small torque nothing of their motion explains.

    A drive without power, whose joint others or hands move, shows noise about an offset: neither
    the load nor what may balance it in part, and no friction, which a torque that is measured has.
    """
    load, torque = sizes(observed)
    # whether its torque counts by now or not: `observed.faster` is of those that do
    fast = np.abs(observed.slow.velocity) > ROWS.rest * observed.sign_width
    found = list[int]()
    for j in np.flatnonzero(torque < SOME * load).tolist():
        use = np.flatnonzero(fast[:, j])
        if use.size < MISTAKES.least_moving:
            continue
        motion, own = observed.slow[use], observed.measured[use, j]
        friction = dry_and_viscous(motion.velocity[:, j])
        its_load = observed.load[observed.kept][use, j]
        columns = np.column_stack([np.ones(own.size), motion.position[:, j], its_load, friction])
        left = own - columns @ np.linalg.lstsq(columns, own, rcond=None)[0]
        unexplained = np.sum(left**2) / (own.size - columns.shape[1])
        if unexplained > MOST**2 * np.var(own):
            found.append(j)
    return tuple(found)


def left_out(observed: Observations) -> tuple[int, ...]:
    """Return the joints (0-based) whose torque is measured, and tells nothing of them."""
    return tuple(sorted({*without_load(observed), *without_effort(observed)}))


def sizes(observed: Observations) -> tuple[FloatArray, FloatArray]:
    """Return the root mean squares of load and torque of each joint, rest included, (n,) each."""
    load, torque = observed.load[observed.kept], observed.measured
    return np.sqrt(np.mean(load**2, axis=0)), np.sqrt(np.mean(torque**2, axis=0))


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
            f"is {apart} {observed.unit('N m')} RMS off (joint by joint): noise, and what "
            "changed in between."
        )


def _repeat(observed: Observations, left: FloatArray, first: int, second: int) -> Repeat | None:
    """Lay one recording over another; None if they are of different motions."""
    rows, others = (np.flatnonzero(observed.recording == k) for k in (first, second))
    if min(rows.size, others.size) < MISTAKES.least_moving:
        return None
    slow = observed.slow
    moves = np.sqrt(np.mean(slow.velocity[rows] ** 2, axis=0)) > ROWS.rest * SIGN_WIDTH
    moves |= np.sqrt(np.mean(slow.velocity[others] ** 2, axis=0)) > ROWS.rest * SIGN_WIDTH
    position, velocity, residual = (
        CubicSpline(slow.time[others], values[others])
        for values in (slow.position, slow.velocity, left)
    )

    def apart(delay: float) -> float:
        """Return the mean square by which positions differ where both are known [rad²]."""
        known = _known(observed, rows, others, delay)
        if known.sum() < 0.5 * rows.size:
            return np.inf
        there = slow.time[rows[known]] + delay
        return float(np.mean((position(there) - slow.position[rows[known]]) ** 2))

    coarse, period = _delay(observed, rows, others), observed.row_period
    best = fminbound(apart, coarse - 2 * period, coarse + 2 * period, xtol=FINE * period)
    delay = float(np.asarray(best).item())
    if not moves.any() or np.sqrt(apart(delay)) > REPEATS.near:
        return None
    known = _known(observed, rows, others, delay)
    own, there = rows[known], slow.time[rows[known]] + delay
    off = np.sqrt(np.mean((velocity(there) - slow.velocity[own]) ** 2, axis=0))
    speed = np.sqrt(np.mean(slow.velocity[own] ** 2, axis=0))
    if (off > np.maximum(LITTLE * speed, ROWS.rest * SIGN_WIDTH))[moves].any():
        return None
    near = np.clip(np.searchsorted(slow.time[others], there), 0, others.size - 1)
    moving = observed.moving[own] & observed.moving[others[near]]
    differ = rmse(left[own] - residual(there), moving) / np.sqrt(2.0)
    return Repeat((first, second), delay, np.where(moving.any(axis=0), differ, np.nan))


def _known(observed: Observations, rows: IntArray, others: IntArray, delay: float) -> BoolArray:
    """Mark the rows (R,) at whose place in the motion the other recording has no gap."""
    time = observed.slow.time
    there = time[rows] + delay
    after = np.clip(np.searchsorted(time[others], there), 1, others.size - 1)
    whole = observed.segment[others[after]] == observed.segment[others[after - 1]]
    return whole & (there >= time[others[0]]) & (there <= time[others[-1]])


def _delay(observed: Observations, rows: IntArray, others: IntArray) -> float:
    """Return how much later the motion is in the second recording's time, to a row [s]."""
    from scipy.signal import correlate, correlation_lags  # slow to import; few have a repeat

    time, speed = observed.slow.time, observed.slow.velocity
    period = observed.row_period
    parts = []
    for own in (rows, others):  # a recording with gaps has no even grid
        grid = np.arange(float(time[own[0]]), float(time[own[-1]]), period)
        parts.append(np.stack([np.interp(grid, time[own], x) for x in speed[own].T], axis=1))
    first, second = parts
    scale = np.maximum(np.sqrt(np.mean(first**2, axis=0)), ROWS.rest * SIGN_WIDTH)
    alike = sum(
        np.asarray(correlate(second[:, j] / scale[j], first[:, j] / scale[j], method="fft"))
        for j in range(observed.n)
    )
    lags = correlation_lags(len(second), len(first))
    return float(lags[int(np.argmax(alike))] * period + time[others[0]] - time[rows[0]])
