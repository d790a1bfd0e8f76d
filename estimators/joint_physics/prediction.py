"""Torque of joint physics with its variance, of what was fitted and of states not known yet.

Joint physics from motion to estimate in one compiled call.

A control loop asks for one sample at a time. Then each call of compiled code costs more than most
of what it computes, and after a wait, when the caches are another program's, several times as much.

The variance of joint physics in terms that are zero most of the time.

The leverage x Rᵀ R xᵀ costs one product for each entry of R. States of friction that have all come
to the same end, ±1, are equal: stops narrower than half the way since the joint turned, and
directions that are steep beside its speed. In the differences z of states that come to their ends
one after the other, x = E z, the same leverage is |L z|² with Lᵀ L = (R E)ᵀ (R E), and a column of
L counts only where its term is not zero. L is lower triangular: the terms that are zero most often
have the longest columns, and stand first. One state goes with all families of friction, so that
their terms are zero together.

Variance of the torque while the initial state of the hysteresis is not known.

Memory begins with all stops in their middle. Before the joint turns, the true stops are anywhere
that they have been in training, z with M = E[z zᵀ], so that the torque g·z has the variance g M gᵀ,
with g the height of each stop: its weight in every family of columns, and what the simulation has
of the same width. Two copies of a stop that began apart come together as the joint turns. After it
turned by R one way, their mean squared distance, for any beginning as likely as another, has fallen
by the factor

    s² = ((1 - r)³ + 1) / 2 + 3 r (1 - r)² / 2    for r = R / w up to 1
    s² = (2 - r)³ / 2                             for r from 1 to 2, and 0 beyond,

whatever the joint did in between: a stop that saw the range 2 w has forgotten its beginning. So the
variance is u M uᵀ with u = s g.

Source: Visintin, "Differential Models of Hysteresis", 1994, ch. III (stops and their memory).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.joint_physics.calibration import judge
from estimators.joint_physics.columns import FRICTION_HARMONICS, SPEEDS, STATES, WIDTHS, scan
from limo_driver.physics import Simulation, TorqueEffect
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.joint_physics.columns import Arm, JointColumns
    from limo_driver.types import BoolArray, FloatArray, IntArray

LANES: Final = 16  # floats that fill the widest vectors
GROUP: Final = 6  # columns of L, taken at a time: as many as there are families of friction
NOTHING: Final = 2.0**-24  # of two states, between which single precision cannot tell

_OF_STOPS: Final = np.arange(WIDTHS.size)
_SHARP: Final = np.arange(WIDTHS.size + SPEEDS.size, STATES)
_SLOW, _FAST = np.split(np.arange(WIDTHS.size, WIDTHS.size + SPEEDS.size), [2])
# A filtered step takes the sharp signs to where directions of 0.02 rad/s are.
_DIRECTIONS: Final = np.concatenate([_SLOW, _SHARP, _FAST])
_WIDE: Final = 4  # stops that hardly ever come to their ends
ORDER: Final = np.concatenate([_OF_STOPS[:-_WIDE], _DIRECTIONS, _OF_STOPS[-_WIDE:], [STATES]])
_WAVES: Final = 2 * FRICTION_HARMONICS  # sines and cosines that friction goes with
_STOPS: Final = WIDTHS.size


@dataclass(frozen=True)
class Prediction:
    """Weights of n joints and roots of their covariances, packed to be read in order.

    A column that was zero in all data has neither weight nor root, and is left out, but for those
    of friction. Roots are of single precision: half as much goes through the cache for each state,
    and of standard deviations nobody reads the seventh digit. What they are roots of stands above.
    """

    kept: IntArray  # columns that count, of one joint after the other
    less: IntArray  # the column taken off each in its term; K, where none is
    sizes: IntArray  # (n,), how many columns count
    weights: FloatArray  # of the columns that count
    roots: NDArray[np.float32]  # groups of columns
    root_sizes: IntArray  # (n,), how many numbers of `roots` are of a joint

    @classmethod
    def of(cls, weights: FloatArray, root: FloatArray, friction: IntArray) -> Prediction:
        """Pack them.

        Args:
            weights: (n, K).
            root: R with covariance Rᵀ R of the weights, (n, K, K).
            friction: Columns of friction, (families, states and dq).
        """
        terms = [terms_of(R, friction) for R in root]
        return cls(
            np.concatenate([own.kept for own in terms]),
            np.concatenate([own.less for own in terms]),
            np.array([own.kept.size for own in terms]),
            np.concatenate([w[own.kept] for w, own in zip(weights, terms, strict=True)]),
            np.concatenate([own.root for own in terms]),
            np.array([own.root.size for own in terms]),
        )


@compiled(
    reads=("columns", "kept", "less", "sizes", "weights", "roots", "root_sizes"),
    nogil=True,
    fastmath={"reassoc", "contract"},
)  # sums in several lanes
def predict(
    columns: FloatArray,
    kept: IntArray,
    less: IntArray,
    sizes: IntArray,
    weights: FloatArray,
    roots: NDArray[np.float32],
    root_sizes: IntArray,
    torque: FloatArray,
    leverage: FloatArray,
) -> None:
    """Write torque and leverage (T, n); the fields of a `Prediction` are the other arguments."""
    first, below = 0, 0
    x = np.empty(columns.shape[2] + GROUP, np.float32)
    y = np.empty(columns.shape[2] + LANES, np.float32)
    for j in range(sizes.size):
        size = sizes[j]
        columns_of, off = kept[first : first + size], less[first : first + size]
        w, root = weights[first : first + size], roots[below : below + root_sizes[j]]
        for t in range(columns.shape[1]):
            row, total = columns[j, t], 0.0
            for k in range(size):
                value = row[columns_of[k]]
                total += value * w[k]
                if off[k] < row.size:
                    change = value - row[off[k]]
                    value = change if abs(change) > NOTHING * abs(value) else 0.0
                x[k] = value
            torque[t, j] = total
            x[size : size + GROUP] = 0.0
            _multiply(root, x, size, y)
            square = 0.0
            for k in range((size + LANES - 1) // LANES * LANES):
                square += np.float64(y[k]) * np.float64(y[k])
            leverage[t, j] = square
        first += size
        below += root_sizes[j]


@compiled(reads=("root",), nogil=True)  # no sum of it may change, so that C gives the same bits
def _multiply(
    root: NDArray[np.float32], x: NDArray[np.float32], size: int, y: NDArray[np.float32]
) -> None:
    """Write y = L x of a lower triangular L of this size, as it is packed, with zeros above."""
    y[:] = 0.0
    rows = (size + LANES - 1) // LANES * LANES
    for k in range(0, size, GROUP):
        top = (rows - size + k) // LANES * LANES
        block, root = root[: GROUP * (rows - top)], root[GROUP * (rows - top) :]
        x0, x1, x2, x3, x4, x5 = x[k], x[k + 1], x[k + 2], x[k + 3], x[k + 4], x[k + 5]
        if x0 == 0.0 and x1 == 0.0 and x2 == 0.0 and x3 == 0.0 and x4 == 0.0 and x5 == 0.0:
            continue
        for v in range(0, rows - top, LANES):
            L, part = block[GROUP * v : GROUP * (v + LANES)], y[top + v : top + v + LANES]
            for i in range(LANES):
                first = L[i] * x0 + L[LANES + i] * x1
                second = L[2 * LANES + i] * x2 + L[3 * LANES + i] * x3
                third = L[4 * LANES + i] * x4 + L[5 * LANES + i] * x5
                part[i] += (first + second) + third


@compiled(
    reads=(
        "position", "velocity", "acceleration", "torque", "base", "kept", "less", "sizes",
        "weights", "roots", "root_sizes", "heights", "moments", "calibration",
    ),
    nogil=True,
)  # fmt: skip
def estimate(
    memory: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    torque: FloatArray,
    arm: Arm,
    base: IntArray,
    step_time: float,
    count: int,
    settled: float,
    kept: IntArray,
    less: IntArray,
    sizes: IntArray,
    weights: FloatArray,
    roots: NDArray[np.float32],
    root_sizes: IntArray,
    heights: FloatArray,
    moments: FloatArray,
    place: int,
    calibration: FloatArray,
    learned: FloatArray,
    std: FloatArray,
    outside: BoolArray,
) -> None:
    """Advance `memory` in place over T samples and write the estimate, (T, n) each.

    Arguments up to `step_time` are those of `scan`; then come the number of columns, how far a
    joint has to have turned [rad], the fields of a `Prediction`, those of an `UnknownMemory`, and
    the `rows` of a `Calibration`.
    """
    T, n = position.shape
    columns, about = np.empty((n, T, count)), np.empty((2, T, n))
    leverage = np.empty((T, n))
    scan(
        memory, position, velocity, acceleration, torque, arm, base, step_time, calibration[-1],
        1, columns, about,
    )  # fmt: skip
    predict(columns, kept, less, sizes, weights, roots, root_sizes, learned, leverage)
    fill_variance(columns, about, heights, moments, place, std)
    judge(calibration, leverage, about[0], velocity, settled, learned, std, outside)


def _next() -> IntArray:
    """Return the state that is taken off each, itself where none is, (states and dq,)."""
    found = np.arange(STATES + 1)
    for chain in (_OF_STOPS, _DIRECTIONS):
        found[chain[:-1]] = chain[1:]
    return found


NEXT: Final = _next()


@dataclass(frozen=True)
class VarianceTerms:
    """Of one joint with p columns: those of friction, and of the others those that count."""

    kept: IntArray  # (p,), the columns, in the order of their terms
    less: IntArray  # (p,), the column taken off each; their number K where none is
    root: NDArray[np.float32]  # L by groups of columns, see `_by_columns`


def terms_of(root: FloatArray, friction: IntArray) -> VarianceTerms:
    """Return the terms of a joint.

    Args:
        root: R, the root of its weights' covariance, (K, K).
        friction: Columns of friction, (families, states and dq).
    """
    count, counts = root.shape[1], np.asarray(root.any(axis=0))
    of_friction = friction[:, ORDER].T.ravel()  # of every family first
    others = np.setdiff1d(np.arange(count), of_friction)
    kept = np.concatenate([of_friction, others[counts[others]]])
    less = np.full(count, count)
    taken_off = np.flatnonzero(np.arange(STATES + 1) != NEXT)
    less[friction[:, taken_off]] = friction[:, NEXT[taken_off]]
    change = np.eye(kept.size)  # z of x
    place = np.full(count + 1, -1)
    place[kept] = np.arange(kept.size)
    taken = place[less[kept]]
    change[taken >= 0, taken[taken >= 0]] = -1.0
    of_terms = root[:, kept] @ np.linalg.inv(change)
    _, upper = np.linalg.qr(of_terms[:, ::-1])
    return VarianceTerms(kept, less[kept], _by_columns(upper[::-1, ::-1]))


def _by_columns(lower: FloatArray) -> NDArray[np.float32]:
    """Return L in the order in which the code reads it: groups of columns, with zeros around.

    A group has whole vectors of rows, from that of its first row to the last, with the zeros before
    its first row. Of each vector the columns follow each other, so that all is read as it lies.
    """
    size = len(lower)
    above = padded(size, LANES) - size  # rows of zeros, so that the last vector is full
    filled = np.zeros((above + size, padded(size, GROUP)), np.float32)
    filled[above:, :size] = lower
    groups = [
        filled[(above + k) // LANES * LANES :, k : k + GROUP].reshape(-1, LANES, GROUP)
        for k in range(0, size, GROUP)
    ]
    return np.concatenate([group.swapaxes(1, 2).ravel() for group in groups])


def padded(size: int, to: int) -> int:
    """Return a size, filled up to a multiple."""
    return -(-size // to) * to


@dataclass(frozen=True)
class UnknownMemory:
    """Heights of the stops of n joints, and how their states went together in training."""

    heights: FloatArray  # (n, 2 + waves, stops) [N m]: constant, with load [1], with each wave
    moments: FloatArray  # (n, stops, stops), E[z zᵀ]
    place: int  # first column of the family `place`, which holds the waves

    @classmethod
    def of(
        cls, columns: JointColumns, weights: FloatArray, moments: FloatArray, simulation: Simulation
    ) -> UnknownMemory:
        """Gather heights from weights (n, K) and the hysteresis of a simulation."""
        heights = weights[:, columns.stops]
        gains = np.diagonal(weights[:, columns.of_family("gain")])
        heights[:, 0] += (1.0 + gains[:, None]) * _simulated(simulation, columns.n)
        return cls(
            np.ascontiguousarray(heights),
            np.ascontiguousarray(moments),
            columns.of_family("place").start,
        )


def moments_of(gram: FloatArray, count: FloatArray, columns: JointColumns) -> FloatArray:
    """Return E[z zᵀ] of the stops from Σ x xᵀ (n, K, K) of so many rows (n,)."""
    stops = slice(first := columns.of_family("friction").start, first + _STOPS)
    return gram[:, stops, stops] / count[:, None, None]


def any_moments(n: int) -> FloatArray:
    """Return what holds for any motion before: all stops as far as they go, the same way."""
    return np.ones((n, _STOPS, _STOPS))


def _simulated(simulation: Simulation, n: int) -> FloatArray:
    """Return the heights of the simulated stops, each shared by the two widths next to its own."""
    heights = np.zeros((n, _STOPS))
    for effect in simulation.effects:
        if isinstance(effect, TorqueEffect):
            for height, width in effect.stops():
                place = np.interp(np.log(width), np.log(WIDTHS), np.arange(_STOPS))
                below = min(int(place), _STOPS - 2)
                heights[effect.joint - 1, below] += (below + 1 - place) * height
                heights[effect.joint - 1, below + 1] += (place - below) * height
    return heights


@compiled(reads=("columns", "about", "heights", "moments"), nogil=True)
def fill_variance(
    columns: FloatArray,
    about: FloatArray,
    heights: FloatArray,
    moments: FloatArray,
    place: int,
    found: FloatArray,
) -> None:
    """Write u M uᵀ of each sample and joint to `found` (T, n)."""
    T, n = found.shape
    u = np.empty(_STOPS)
    for t in range(T):
        for j in range(n):
            turned, load = about[0, t, j], abs(about[1, t, j])
            first = 0  # stop that remembers, the narrowest
            while first < _STOPS and turned >= 2.0 * WIDTHS[first]:
                first += 1
            for i in range(first, _STOPS):
                height = heights[j, 0, i] + load * heights[j, 1, i]
                for k in range(_WAVES):
                    height += columns[j, t, place + k] * heights[j, 2 + k, i]
                u[i] = height * remembered(turned / WIDTHS[i])
            total = 0.0
            for i in range(first, _STOPS):
                for k in range(first, _STOPS):
                    total += u[i] * moments[j, i, k] * u[k]
            found[t, j] = max(total, 0.0)


@compiled(nogil=True)
def remembered(r: float) -> float:
    """Return s, how far apart two copies of a stop still are after r widths, on average."""
    if r >= 1.0:
        return np.sqrt(0.5 * (2.0 - r) ** 3)
    return np.sqrt(0.5 * ((1.0 - r) ** 3 + 1.0) + 1.5 * r * (1.0 - r) ** 2)
