"""Torque and its variance from columns, weights and the covariance of weights, compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.joint_physics.variance_terms import GROUP, LANES, NOTHING, terms_of
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Prediction:
    """Weights of n joints and roots of their covariances, packed to be read in order.

    A column that was zero in all data has neither weight nor root, and is left out, but for those
    of friction. Roots are of
    single precision: half as much goes through the cache for each state, and of standard deviations
    nobody reads the seventh digit. See `variance_terms` for what they are roots of.
    """

    kept: NDArray[np.int64]  # columns that count, of one joint after the other
    less: NDArray[np.int64]  # the column taken off each in its term; K, where none is
    sizes: NDArray[np.int64]  # (n,), how many columns count
    weights: FloatArray  # of the columns that count
    roots: NDArray[np.float32]  # groups of columns
    root_sizes: NDArray[np.int64]  # (n,), how many numbers of `roots` are of a joint

    @classmethod
    def of(cls, weights: FloatArray, root: FloatArray, friction: NDArray[np.int64]) -> Prediction:
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

    def of_columns(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x · w [N m] and the leverage x Rᵀ R xᵀ [N² m²] of columns (n, T, K), (T, n)."""
        n, T, _ = columns.shape
        torque, leverage = np.empty((T, n)), np.empty((T, n))
        predict(
            columns,
            self.kept,
            self.less,
            self.sizes,
            self.weights,
            self.roots,
            self.root_sizes,
            torque,
            leverage,
        )
        return torque, leverage


@compiled(
    reads=("columns", "kept", "less", "sizes", "weights", "roots", "root_sizes"),
    nogil=True,
    fastmath={"reassoc", "contract"},
)  # sums in several lanes
def predict(
    columns: FloatArray,
    kept: NDArray[np.int64],
    less: NDArray[np.int64],
    sizes: NDArray[np.int64],
    weights: FloatArray,
    roots: NDArray[np.float32],
    root_sizes: NDArray[np.int64],
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
