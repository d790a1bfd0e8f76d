"""Normal equations: all that a linear regression needs of any number of rows."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class NormalEquations:
    """Sums over rows x (K,) with targets y; rows of which errors are known count by these.

    Energy and rows are NaN where nothing asks for them.
    """

    gram: FloatArray  # (K, K), Σ x xᵀ
    product: FloatArray  # (K,), Σ x y
    energy: float = nan  # Σ y² [N² m²]
    rows: float = nan

    @classmethod
    def of(cls, x: FloatArray, y: FloatArray) -> NormalEquations:
        """Sum over rows of columns x (T, K) and residual y (T,) [N m]."""
        return cls(x.T @ x, x.T @ y, float(y @ y), float(y.size))

    @property
    def rms(self) -> FloatArray:
        """Root mean square of each column, (K,)."""
        return np.sqrt(np.diag(self.gram) / self.rows)

    def error(self, weights: FloatArray) -> float:
        """Return Σ (y - x·w)² [N² m²]; rounding makes no exact fit better than that."""
        left = self.energy + float(weights @ (self.gram @ weights - 2 * self.product))
        return max(left, 0.0)

    def worth(self, share: float) -> NormalEquations:
        """Return the same as if it were a share of the rows."""
        return NormalEquations(
            share * self.gram, share * self.product, share * self.energy, share * self.rows
        )
