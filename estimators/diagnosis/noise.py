"""Noise: how the residual would look if the simulation were right.

Errors of a torque sensor are correlated in time. Taken for white, any slow wave in them becomes a
discovery. Each joint's errors are an autoregression on the slow grid, and everything is compared
after whitening with it.

Source: Box, Jenkins and Reinsel, "Time Series Analysis", 1994, ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

ORDER = 3
_RIDGE = 1e-3  # of the variance, so that a residual of nothing still has an autoregression
_LEAST = 1e-4  # [N m], below any torque sensor


@dataclass(frozen=True)
class Noise:
    """Errors of n joints on K rows: e_t = Σ_i weight_i e_{t-i} + white."""

    weight: FloatArray  # (n, ORDER)
    white: FloatArray  # (n,) standard deviation of the white part [N m]
    segment: NDArray[np.int64]  # (K,)

    @classmethod
    def of(cls, residual: FloatArray, use: NDArray[np.bool_], segment: NDArray[np.int64]) -> Noise:
        """Fit to residuals (K, n) on the rows in `use` (K, n)."""
        n = residual.shape[1]
        weight, white = np.zeros((n, ORDER)), np.zeros(n)
        complete = _complete(segment)
        for j in range(n):
            e = residual[:, j]
            past = np.stack([np.roll(e, lag) for lag in range(1, ORDER + 1)], axis=1)
            rows = use[:, j] & complete
            for lag in range(1, ORDER + 1):
                rows &= np.roll(use[:, j], lag)
            X, y = past[rows], e[rows]
            if len(y) <= ORDER:
                white[j] = max(_LEAST, float(np.std(e)))
                continue
            gram = X.T @ X
            gram += _RIDGE * np.trace(gram) / ORDER * np.eye(ORDER) + 1e-30 * np.eye(ORDER)
            weight[j] = _stable(np.linalg.solve(gram, X.T @ y))
            white[j] = max(_LEAST, float(np.sqrt(np.mean((y - X @ weight[j]) ** 2))))
        return cls(weight, white, segment)

    @property
    def complete(self) -> NDArray[np.bool_]:
        """Mark rows whose past is in the same stretch, (K,)."""
        return _complete(self.segment)

    def whiten(self, values: FloatArray, joint: int) -> FloatArray:
        """Whiten one joint's errors or columns, (K, ...), to unit variance."""
        result = values.copy()
        for lag, weight in enumerate(self.weight[joint], start=1):
            result[lag:] -= weight * values[:-lag]
        return result / self.white[joint]

    def scaled(self, factor: FloatArray) -> Noise:
        """Return the noise with each joint's deviation times a factor (n,)."""
        return Noise(self.weight, self.white * factor, self.segment)


def _complete(segment: NDArray[np.int64]) -> NDArray[np.bool_]:
    complete = np.ones(segment.size, dtype=bool)
    for lag in range(1, ORDER + 1):
        complete[:lag] = False
        complete[lag:] &= segment[lag:] == segment[:-lag]
    return complete


def _stable(weight: FloatArray) -> FloatArray:
    """Shrink an autoregression whose errors would grow or never forget."""
    for _ in range(50):
        companion = np.eye(weight.size, k=-1)
        companion[0] = weight
        if np.abs(np.linalg.eigvals(companion)).max() < _LONGEST:
            break
        weight = 0.98 * weight
    return weight


_LONGEST = 0.98  # largest root: forgets within 50 rows
