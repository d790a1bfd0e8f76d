"""Torque and its variance from columns, weights and the covariance of weights, compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Prediction:
    """Weights w of n joints and roots R of their covariances Rᵀ R, packed to be read in order.

    R is lower triangular. A column that was zero in all data has neither weight nor root, and is
    left out. Roots are of single precision: half a megabyte less goes through the cache for each
    state, and of standard deviations nobody reads the seventh digit.
    """

    kept: NDArray[np.int64]  # columns that count, of one joint after the other
    sizes: NDArray[np.int64]  # (n,), how many those are
    weights: FloatArray  # of the columns that count
    roots: NDArray[np.float32]  # rows of each R up to the diagonal

    @classmethod
    def of(cls, weights: FloatArray, root: FloatArray) -> Prediction:
        """Pack weights (n, K) and roots (n, K, K)."""
        kept = [np.flatnonzero(R.any(axis=0)) for R in root]
        packed = [R[np.ix_(k, k)][np.tril_indices(k.size)] for R, k in zip(root, kept, strict=True)]
        return cls(
            np.concatenate(kept),
            np.array([k.size for k in kept]),
            np.concatenate([w[k] for w, k in zip(weights, kept, strict=True)]),
            np.concatenate(packed).astype(np.float32),
        )

    def of_columns(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x · w [N m] and the leverage x Rᵀ R xᵀ [N² m²] of columns (n, T, K), (T, n)."""
        n, T, _ = columns.shape
        torque, leverage = np.empty((T, n)), np.empty((T, n))
        _predict(columns, self.kept, self.sizes, self.weights, self.roots, torque, leverage)
        return torque, leverage


@compiled(
    reads=("columns", "kept", "sizes", "weights", "roots"),
    nogil=True,
    fastmath={"reassoc", "contract"},
)  # sums in several lanes
def _predict(
    columns: FloatArray,
    kept: NDArray[np.int64],
    sizes: NDArray[np.int64],
    weights: FloatArray,
    roots: NDArray[np.float32],
    torque: FloatArray,
    leverage: FloatArray,
) -> None:
    """Write torque and leverage (T, n); the fields of a `Prediction` are the other arguments."""
    first, below = 0, 0
    for j in range(sizes.size):
        size = sizes[j]
        x, w = np.empty(size, np.float32), weights[first : first + size]
        for t in range(columns.shape[1]):
            total = 0.0
            for k in range(size):
                value = columns[j, t, kept[first + k]]
                x[k] = value
                total += value * w[k]
            torque[t, j] = total
            total, start = 0.0, below
            for i in range(size):
                y = np.float32(0.0)
                for k in range(i + 1):
                    y += roots[start + k] * x[k]
                total += y * y
                start += i + 1
            leverage[t, j] = total
        first += size
        below += size * (size + 1) // 2
