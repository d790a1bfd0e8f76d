"""Surrogate: a black box that tells unknown physics from noise in the remaining residual.

What no effect of the catalogue explains is either noise or unknown physics. Unknown physics is a
function of the motion, so a black box can predict it on rows that it has not seen; noise it
cannot. The black box is a ridge regression on many features of the joint's own motion, the loads
and speeds of the others, and time.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.hypotheses.responses import over_joint
from estimators.diagnosis.held_out import block_of
from estimators.diagnosis.quantities import rounded
from estimators.diagnosis.settings import FEW, FINE, MOST, NEARLY_ALL, SOME, TINY
from estimators.diagnosis.settings.judgement import BLACK_BOX, PUSHES
from estimators.diagnosis.settings.residuals import HELD_OUT, NOISE, SWINGS
from estimators.diagnosis.verdict import Where
from estimators.regression.definite import inverse_root
from limo_driver.physics import PreslidingHysteresis

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import BoolArray, FloatArray, IntArray

_SPEED = ("at low speed", "at high speed")
_REVERSAL = ("soon after reversals", "long after reversals")
_LOAD = ("at low load", "at high load")


def predictable_part(observed: Observations, residual: FloatArray, joint: int) -> FloatArray:
    """Return the part of one joint's residual that a black box predicts, each row from others.

    Args:
        observed: Recordings and simulation.
        residual: (K,) [N m].
        joint: 0-based.

    Returns:
        Predicted residual, (K,) [N m]; zero where nothing can be predicted.
    """
    features = _features(observed, joint) * observed.moving[:, joint, None]
    residual = residual * observed.moving[:, joint]
    X = features / np.maximum(np.sqrt(np.mean(features**2, axis=0)), TINY)
    fold = _folds(observed)
    grams = [X[fold == k].T @ X[fold == k] for k in range(BLACK_BOX.folds)]
    products = [X[fold == k].T @ residual[fold == k] for k in range(BLACK_BOX.folds)]
    gram, product = np.sum(grams, axis=0), np.sum(products, axis=0)
    best = np.zeros_like(residual)
    least = float(np.sum(residual**2))
    for ridge in np.geomspace(*BLACK_BOX.ridges):
        guess = np.empty_like(residual)
        for k in range(BLACK_BOX.folds):
            M = gram - grams[k] + ridge * len(residual) * np.eye(X.shape[1])
            root = inverse_root(M)
            found = root.T @ (root @ (product - products[k]))
            guess[fold == k] = X[fold == k] @ found
        error = float(np.sum((residual - guess) ** 2))
        if error < least:
            best, least = guess, error
    return best


def _folds(observed: Observations) -> IntArray:
    """Cut every recording into blocks of time and deal them out, (K,)."""
    since = observed.slow.time - observed.slow.time[0]
    block = np.floor(since / block_of(observed, HELD_OUT.block)).astype(np.int64)
    return (block + 2 * observed.recording) % BLACK_BOX.folds


def _features(observed: Observations, j: int) -> FloatArray:
    motion, load = observed.motion, observed.load
    q, v = motion.position[:, j], motion.velocity[:, j]
    sign = np.tanh(v / BLACK_BOX.speeds[0])
    own = [np.tanh(v / speed) for speed in np.geomspace(*BLACK_BOX.speeds)]
    own += [v, v * np.abs(v), motion.acceleration[:, j], np.ones_like(v), _rested(observed, j)]
    own += stops(observed, j)
    waves = [f(k * q) for k in range(1, FEW + 1) for f in (np.sin, np.cos)]
    own += waves + [sign * wave for wave in waves]
    own += [sign * np.abs(load[:, k]) for k in range(observed.n)]
    own += [load[:, k] for k in range(observed.n)]
    for k in range(observed.n):
        if k != j:
            other = motion.velocity[:, k]
            alone, on_own = (np.tanh(other / speed) for speed in BLACK_BOX.of_others)
            own += [other, alone, sign * np.abs(on_own)]
    filtered = observed.filter(np.stack(own, axis=1))
    hats = _hats(observed)
    slow_sign = filtered[:, :1]
    return np.concatenate([filtered, hats, slow_sign * hats], axis=1)


def stops(observed: Observations, j: int) -> list[FloatArray]:
    """Return friction of a joint (0-based) that builds up over the ways that its rows show."""
    widths = np.geomspace(*BLACK_BOX.widths)
    return [over_joint(PreslidingHysteresis.stop(j + 1, width), observed) for width in widths]


def _rested(observed: Observations, j: int) -> FloatArray:
    """Return the friction of stiction: the sign of motion, decaying since the joint last rested."""
    result = np.zeros(len(observed.motion))
    for rows in observed.segments:
        v, time = observed.motion.velocity[rows, j], observed.motion.time[rows]
        still = np.abs(v) < BLACK_BOX.at_rest
        last = np.where(still, np.arange(v.size), -1)
        last = np.maximum.accumulate(last)
        since = np.where(last >= 0, time - time[np.maximum(last, 0)], np.inf)
        result[rows] = np.sign(v) * np.exp(-since / PUSHES.spread)
    return result


def _hats(observed: Observations) -> FloatArray:
    """Return hat functions of time over each recording, (K, hats)."""
    parts: list[FloatArray] = []
    for recording in range(len(observed.recordings)):
        rows = observed.recording == recording
        time = observed.slow.time
        knots = np.linspace(time[rows].min(), time[rows].max(), BLACK_BOX.hats)
        width = knots[1] - knots[0]
        hats = np.maximum(0.0, 1.0 - np.abs(time[:, None] - knots) / width)
        parts.append(hats * rows[:, None])
    return np.concatenate(parts, axis=1)


def swings(residual: FloatArray, use: BoolArray, segment: IntArray) -> BoolArray:
    """Mark the joints (n,) whose errors (K, n) are predicted by those right before, as swings are.

    In short blocks of rows in `use` (K, n), within segments (K,): a swing changes its frequency
    with the inertia of the pose. What is slow in a block is taken out.
    """
    size, order, found = SWINGS.rows, NOISE.order, np.zeros(use.shape[1], dtype=bool)
    polynomials = np.vander(np.linspace(-1.0, 1.0, size), order + 1)
    slow = np.linalg.qr(polynomials)[0]
    for j, rows in enumerate(use.T):
        ends = np.flatnonzero(np.diff(np.where(rows, segment, -1), prepend=-1, append=-1))
        starts = [
            a for i, k in pairwise(ends.tolist()) if rows[i] for a in range(i, k - size + 1, size)
        ]
        if len(starts) < SWINGS.blocks:
            continue
        blocks = residual[np.array(starts)[:, None] + np.arange(size), j]
        blocks = blocks - blocks @ slow @ slow.T
        before = np.stack([blocks[:, order - k : size - k] for k in range(1, order + 1)], axis=2)
        own, A = blocks[:, order:, None], before.transpose(0, 2, 1)
        gram = A @ before + FINE * np.mean(blocks**2) * np.eye(order)
        left = own - before @ np.linalg.solve(gram, A @ own)
        found[j] = np.sum(own**2) > SWINGS.predicted * np.sum(left**2)
    return found


def where_of(observed: Observations, torque: FloatArray, joint: int) -> Where:
    """Say where a torque of one joint has most of its energy, compared with where the joint was.

    Args:
        observed: Recordings and simulation, K slow rows.
        torque: What is found, or left, (K,) [N m].
        joint: 0-based.
    """
    rows = np.flatnonzero(observed.moving[:, joint])
    energy = torque[rows] ** 2
    figure = f"joint-{joint + 1}"
    if not rows.size or energy.sum() <= 0:
        return Where(region=f"joint {joint + 1}", figure=figure)
    samples = observed.kept[rows]
    speed, far, push = (observed.unit(unit, joint) for unit in ("rad/s", "rad", "N m"))
    parts = [
        *_side(_SPEED, speed, np.abs(observed.slow.velocity[rows, joint]), energy),
        *_side(_REVERSAL, far, observed.since_reversal[samples, joint], energy),
        *_side(_LOAD, push, np.abs(observed.load[samples, joint]), energy),
        *_range(observed.slow.position[rows, joint], energy, far),
    ]
    recordings, time = _stretches(observed, rows, energy)
    if time:
        parts.append("most of it in a short part of the time")
    text = f"joint {joint + 1}" + (": " + ", ".join(parts) if parts else ", all over the motion")
    return Where(time=time, recording=recordings, region=text, figure=figure)


def _side(names: tuple[str, str], unit: str, values: FloatArray, energy: FloatArray) -> list[str]:
    """Say whether the energy lies at small or at large values (R,), if it does.

    Args:
        names: Of small and of large values.
        unit: Of them.
        values: In which each row was.
        energy: Of each row.
    """
    order = np.argsort(values, kind="stable")
    total = np.cumsum(energy[order])
    half = float(values[order][min(np.searchsorted(total, 0.5 * total[-1]), len(order) - 1)])
    usual = float(np.median(values))
    if usual <= 0 or abs(np.log2(half / usual)) < 1:
        return []
    name, side = (names[0], "below") if half < usual else (names[1], "above")
    return [f"{name} (half of it {side} {rounded(half, 2)} {unit})"]


def _range(position: FloatArray, energy: FloatArray, unit: str) -> list[str]:
    """Say which narrow range of positions (R,), in this unit, has half the energy, if one does."""
    order = np.argsort(position, kind="stable")
    first, last = _narrowest(energy[order], 0.5)
    if (last - first) > SOME * len(order):
        return []
    low, high = position[order][[first, last - 1]]
    return [f"near one position (half of it between {low:.3f} and {high:.3f} {unit})"]


def _stretches(
    observed: Observations, rows: NDArray[np.intp], energy: FloatArray
) -> tuple[tuple[int, ...], tuple[tuple[float, float], ...]]:
    """Return the stretch of time in each of the fewest recordings that have most of the energy.

    Nothing if it is spread over the motion. Recordings are counted from 1.
    """
    of = observed.recording[rows]
    held = np.bincount(of, energy, len(observed.recordings)) / energy.sum()
    found: list[tuple[int, tuple[float, float]]] = []
    used = 0
    for recording in np.argsort(-held, kind="stable"):
        if sum(held[k - 1] for k, _ in found) >= NEARLY_ALL:
            break
        own = np.flatnonzero(of == recording)
        first, last = _narrowest(energy[own], MOST)
        used += last - first
        time = observed.slow.time[rows[own[[first, last - 1]]]]
        found.append((int(recording) + 1, (float(time[0]), float(time[1]))))
    if used > SOME * len(rows):
        return (), ()
    return tuple(k for k, _ in sorted(found)), tuple(time for _, time in sorted(found))


def _narrowest(energy: FloatArray, part: float) -> tuple[int, int]:
    """Return the fewest rows in a row, first to before last, that have a part of the energy."""
    total = np.concatenate([[0.0], np.cumsum(energy)])
    ends = np.searchsorted(total, total[:-1] + part * total[-1] * (1 - 1e-9))
    ends = ends[ends < total.size]  # from later rows on, too little follows
    first = int(np.argmin(ends - np.arange(ends.size)))
    return first, int(ends[first])
