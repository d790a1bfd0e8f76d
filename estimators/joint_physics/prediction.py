"""Torque and its variance from columns, weights and the covariance of weights, compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.joint_physics.variance_terms import GROUP, LANES, terms_of
from limo_driver.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Prediction:
    """Weights of n joints and roots of their covariances, packed to be read in order.

    A column that was zero in all data has neither weight nor root, and is left out. Roots are of
    single precision: half as much goes through the cache for each state, and of standard deviations
    nobody reads the seventh digit. See `variance_terms` for what they are roots of.
    """

    kept: NDArray[np.int64]  # columns that count, of one joint after the other
    less: NDArray[np.int64]  # the column taken off each in its term; K, where none is
    sizes: NDArray[np.int64]  # (n,), how many columns count
    weights: FloatArray  # of the columns that count
    roots: NDArray[np.float32]  # groups of four columns
    root_sizes: NDArray[np.int64]  # (n,), how many numbers of `roots` are of a joint

    @classmethod
    def of(cls, weights: FloatArray, root: FloatArray, stops: NDArray[np.int64]) -> Prediction:
        """Pack them.

        Args:
            weights: (n, K).
            root: R with covariance Rᵀ R of the weights, (n, K, K).
            stops: Columns of the stops, (families, widths), the narrowest first.
        """
        terms = [terms_of(R, stops) for R in root]
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
        _predict(
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
def _predict(
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
                x[k] = value - (row[off[k]] if off[k] < row.size else 0.0)
            torque[t, j] = total
            x[size : size + GROUP] = 0.0
            _multiply(root, x, size, y)
            square = 0.0
            for k in range(size):
                square += np.float64(y[k]) * np.float64(y[k])
            leverage[t, j] = square
        first += size
        below += root_sizes[j]


@compiled(reads=("root",), nogil=True)  # no sum of it may change, so that C gives the same bits
def _multiply(
    root: NDArray[np.float32], x: NDArray[np.float32], size: int, y: NDArray[np.float32]
) -> None:
    """Write y = L x of a lower triangular L of this size, which stands in groups of columns."""
    y[:] = 0.0
    for k in range(0, size, GROUP):
        height = (size - k + LANES - 1) // LANES * LANES
        group, root = root[: GROUP * height], root[GROUP * height :]
        x0, x1, x2, x3 = x[k], x[k + 1], x[k + 2], x[k + 3]
        if x0 == 0.0 and x1 == 0.0 and x2 == 0.0 and x3 == 0.0:
            continue
        L0, L1 = group[:height], group[height : 2 * height]
        L2, L3 = group[2 * height : 3 * height], group[3 * height :]
        part = y[k : k + height]
        for i in range(height):
            part[i] += (L0[i] * x0 + L1[i] * x1) + (L2[i] * x2 + L3[i] * x3)
