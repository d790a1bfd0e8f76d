"""How far a fit is off on motion that it was not fitted to, and from where on nobody knows.

    variance of the error = c (σ² + x Σ xᵀ)

with the noise σ² and the posterior covariance Σ of the weights. The factor c of each joint is such
that 95 % of the errors on folds left out are within 1.96 standard deviations (split conformal
prediction). Motion whose leverage x Σ xᵀ shows beside the noise and is beyond nearly all of what
the folds were judged on is outside: the formula still grows there, but no error confirms it.

Source: MacKay, "Bayesian interpolation", Neural Computation 1992, sec. 6 (error bars); Lei et al.,
"Distribution-free predictive inference for regression", JASA 2018 (the factor).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import DEVIATIONS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.joint_physics.evidence import Fit, Posterior
    from estimators.joint_physics.normal_equations import JudgedRows
    from limo_driver.types import FloatArray

COVERAGE: Final = 0.95
_INSIDE: Final = 0.999  # of the judged rows
_SHOWS: Final = 0.1  # [σ²]; a smaller leverage adds less than 5 % to the standard deviation


@dataclass(frozen=True)
class Calibration:
    """Of n joints."""

    noise: FloatArray  # (n,) [N² m²], σ²
    factor: FloatArray  # (n,), c
    farthest: FloatArray  # (n,) [N² m²], leverage from which on motion is outside

    def std(self, leverage: FloatArray) -> FloatArray:
        """Return standard deviations (T, n) [N m]."""
        return np.sqrt(self.factor * (self.noise + leverage))

    def outside(self, leverage: FloatArray) -> NDArray[np.bool_]:
        """Return which motion is outside what was judged, (T, n)."""
        return leverage > self.farthest


def calibrate(judged: JudgedRows, fits: Sequence[Fit]) -> Calibration:
    """Judge each joint's fits without a fold on the rows of that fold.

    Args:
        judged: Rows of all folds.
        fits: Of each joint.
    """
    found = [
        _calibrate_joint(*_judge(judged, fit.without, j), fit.prior.noise)
        for j, fit in enumerate(fits)
    ]
    return Calibration(*(np.array(values) for values in zip(*found, strict=True)))


def leverage_of(x: FloatArray, root: FloatArray) -> FloatArray:
    """Return x Σ xᵀ of rows (T, K), the variance that unsure weights give the torque, (T,)."""
    return np.sum((x @ root.T) ** 2, axis=1)


def _judge(
    judged: JudgedRows, without: Sequence[Posterior], joint: int
) -> tuple[FloatArray, FloatArray]:
    """Return errors [N m] and leverages [N² m²] of one joint's settled rows."""
    error, leverage = judged.residual[:, joint].copy(), np.zeros(judged.fold.size)
    for fold, fit in enumerate(without):
        rows = judged.fold == fold
        x = judged.columns[joint, rows].astype(np.float64)
        error[rows] -= x @ fit.weights
        leverage[rows] = leverage_of(x, fit.root)
    settled = judged.settled[:, joint]
    return error[settled], leverage[settled]


def _calibrate_joint(
    error: FloatArray, leverage: FloatArray, noise: float
) -> tuple[float, float, float]:
    """Return noise, factor and farthest leverage of one joint."""
    deviations = np.abs(error) / np.sqrt(noise + leverage)
    factor = float(np.quantile(deviations, COVERAGE) / DEVIATIONS) ** 2
    return noise, factor, max(float(np.quantile(leverage, _INSIDE)), _SHOWS * noise)
