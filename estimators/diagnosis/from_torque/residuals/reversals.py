"""Reversals: where joints turn or stop, and how large their errors usually are about that.

Friction, play and the controller do most where a joint turns, and much the same each time. So an
error there is held against those that the same joint leaves as long before or after its other
reversals, not against those of steady motion.

Rarity: how seldom a joint's errors are as large over some seconds as they are in one place.

Where not all physics is known, errors are larger in some stretches than in others, and the largest
of many is no event. Over stretches of one length, their energy is that of noise whose variance is
itself drawn for each: a chi-square over another one, so that its ratio to what is usual has an F
distribution. How many degrees of freedom that variance has is read off the scatter of energies.

Source: Smyth, "Linear models and empirical Bayes methods for assessing differential expression in
microarray experiments", 2004, section 6.2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.optimize import root_scalar
from scipy.special import polygamma
from scipy.stats import f as ratio_of_variances
from scipy.stats import norm

from estimators.diagnosis.from_torque.residuals.noise import usual_error
from estimators.diagnosis.settings import MATTERS, MOST, NEARLY_ALL, TINY
from estimators.diagnosis.settings.judgement import PUSHES

if TYPE_CHECKING:
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import BoolArray, FloatArray, IntArray

_LEAST = float(np.log(np.finfo(float).tiny))


def steadily_moving(observed: Observations) -> BoolArray:
    """Mark the rows (K, n) on which a joint moves on for a while, in one direction.

    A joint that turns stops and starts, however fast it passes through rest.
    """
    steady = observed.moving & ~_turning(observed)
    settled = minimum_filter1d(steady, 2 * rows_in(observed, PUSHES.spread) + 1, axis=0)
    return np.asarray(settled, dtype=bool)


def ends_of_motion(observed: Observations) -> BoolArray:
    """Mark the rows (K,) outside the motion of a recording, and in its first and last moments.

    Those are of starting and of braking.
    """
    time, moves = observed.slow.time, observed.moving.any(axis=1)
    result = np.zeros(time.size, dtype=bool)
    for recording in range(len(observed.recordings)):
        rows = observed.recording == recording
        inside = time[rows & moves]
        if inside.size:
            early, late = inside[0] + PUSHES.ends, inside[-1] - PUSHES.ends
            result[rows & ((time < early) | (time > late))] = True
    return result


def about_reversals(observed: Observations) -> BoolArray:
    """Mark the rows (K, n) on which a joint turns, has just turned or is about to.

    Not those near a moment in which no joint moves: that is an end of the motion.
    """
    still = ~observed.moving.any(axis=1)
    near = maximum_filter1d(still, 2 * rows_in(observed, PUSHES.ends) + 1)
    ends = np.asarray(near, dtype=bool) | ends_of_motion(observed)
    return np.asarray(observed.moving & ~steadily_moving(observed) & ~ends[:, None])


def usual_about_reversals(
    observed: Observations, errors: FloatArray, steady: BoolArray, turns: BoolArray
) -> FloatArray:
    """Return how large errors usually are about a reversal, over those of steady motion, (K, n).

    At least one; one away from reversals, and infinite where too few are alike.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        errors: Whitened, so of about one, (K, n).
        steady: Rows of steady motion or rest, (K, n).
        turns: Rows about reversals, (K, n).
    """
    result, stops = np.ones_like(errors), _turning(observed) | ~observed.moving
    for j in range(observed.n):
        rows = np.flatnonzero(turns[:, j])
        if rows.size and steady[:, j].any():
            usual = max(usual_error(errors[steady[:, j], j]), TINY)
            squares = errors[rows, j] ** 2
            large = _large_at_others(squares, rows, stops[:, j], observed.moving[:, j])
            result[rows, j] = np.maximum(1.0, np.sqrt(large) / usual)
    return result


def _large_at_others(
    squares: FloatArray, rows: IntArray, stops: BoolArray, moving: BoolArray
) -> FloatArray:
    """Return what squares (R,) of some rows (R,) reach as long before or after other stops, (R,).

    Of stops that are passed as fast as the row's own, where there are enough of them.
    """
    first = np.flatnonzero(stops & ~np.concatenate([[False], stops[:-1]]))
    slow = np.logical_or.reduceat(stops & ~moving, first)
    index, far = np.arange(stops.size), 2 * stops.size
    since = index - np.maximum.accumulate(np.where(stops, index, -far))
    until = np.minimum.accumulate(np.where(stops, index, far)[::-1])[::-1] - index
    stop = (np.searchsorted(first, index, side="right") - (since <= until))[rows]
    offset = np.where(since <= until, since, -until)[rows]
    most = int(np.abs(offset).max())
    column = offset + most
    table = np.full((first.size, 2 * most + 1), -1.0)  # negative where no row is
    np.maximum.at(table, (stop, column), squares)
    before, at, after = np.split(table, [most, most + 1], axis=1)
    near = np.hstack([_widened(before), at, _widened(after)])
    result = _quantile_of_others(near)
    for alike in (slow, ~slow):
        own = _quantile_of_others(near[alike])
        result[alike] = np.where(np.isfinite(own), own, result[alike])
    return result[stop, column]


def _widened(table: FloatArray) -> FloatArray:
    """Return the largest of neighbours, (S, c): stops fall anywhere between two rows."""
    return np.asarray(maximum_filter1d(table, 3, axis=1)) if table.size else table


def _quantile_of_others(table: FloatArray) -> FloatArray:
    """Return a high quantile of a column (S, c) less one's own, infinite if they are too few."""
    known = table >= 0.0
    table = np.where(known, table, np.inf)
    rank = np.argsort(np.argsort(table, axis=0, kind="stable"), axis=0, kind="stable")
    others = known.sum(axis=0) - known
    at = NEARLY_ALL * np.maximum(others - 1, 0)
    ordered = np.sort(np.vstack([table, np.full((2, table.shape[1]), np.inf)]), axis=0)
    low, high = (
        np.take_along_axis(ordered, place + (place >= rank), axis=0)
        for place in (np.floor(at).astype(int), np.ceil(at).astype(int))
    )
    enough = known & (others >= PUSHES.fewest_turns)
    low, high = np.where(enough, low, 0.0), np.where(enough, high, 0.0)
    return np.where(enough, low + (at % 1.0) * (high - low), np.inf)


def _turning(observed: Observations) -> BoolArray:
    """Mark the last row (K, n) before a joint turns, and the first after.

    Or before and after it all but stops, to go on as before: its friction does the same.
    """
    velocity, moving = observed.slow.velocity, observed.moving
    usual = [
        np.median(np.abs(velocity[use, j])) if use.any() else 0.0 for j, use in enumerate(moving.T)
    ]
    slow = MATTERS * np.array(usual)
    ahead = np.where(np.abs(velocity) < slow, 0.0, np.sign(velocity))
    turns = (ahead[1:] != ahead[:-1]) & (observed.segment[1:] == observed.segment[:-1])[:, None]
    none = np.zeros((1, observed.n), dtype=bool)
    return np.concatenate([turns, none]) | np.concatenate([none, turns])


def rows_in(observed: Observations, seconds: float) -> int:
    """Return how many rows some seconds are."""
    return round(seconds / observed.row_period)


def surprisal(energy: FloatArray, others: FloatArray, freedom: float) -> FloatArray:
    """Return how seldom stretches have so much energy by chance, -log of it, (S,) [nat].

    Args:
        energy: Sums of squared errors over some stretches, (S,).
        others: Those over other stretches of the same length, (R,); most of them are no events.
        freedom: Independent errors in a stretch.
    """
    upper = MOST
    usual, large = np.log(np.maximum(np.quantile(others, (0.5, upper)), np.finfo(float).tiny))
    scatter = ((large - usual) / norm.ppf(upper)) ** 2  # of logs, robust
    drawn = _freedom(float(scatter - polygamma(1, freedom / 2.0)))
    chance = ratio_of_variances.logsf(energy / np.exp(usual), freedom, drawn)
    return -np.maximum(chance, _LEAST)


def _freedom(scatter: float) -> float:
    """Return the degrees of freedom of a chi-square whose logarithm has such a variance."""

    def beyond(freedom: float) -> float:
        return float(polygamma(1, freedom / 2.0)) - scatter

    few, many = PUSHES.freedom
    if beyond(many) >= 0.0:
        return many
    return float(root_scalar(beyond, bracket=(few, many)).root) if beyond(few) > 0.0 else few
