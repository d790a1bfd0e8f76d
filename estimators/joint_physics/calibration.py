"""How far a fit is off on motion that it was not fitted to, and from where on nobody knows.

    variance of the error = a σ² + b x Σ xᵀ

with the noise σ² and the posterior covariance Σ of the weights: a and b of each joint are those
that make the errors on folds left out most probable, and both grow or shrink together until 95 %
of these errors are within 1.96 standard deviations (split conformal prediction). Motion whose
leverage x Σ xᵀ is beyond nearly all of what the folds were judged on is outside: the formula still
holds there, but no error has confirmed it.

Source: Lei et al., "Distribution-free predictive inference for regression", JASA 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.joint_physics.evidence import Fit, Posterior
    from estimators.joint_physics.normal_equations import JudgedRows
    from limo_driver.types import FloatArray

COVERAGE: Final = 0.95
_DEVIATIONS: Final = 1.959964  # of a normal distribution, that hold it
_INSIDE: Final = 0.999  # of the judged rows
_TINY: Final = 1e-12  # [N² m²]


@dataclass(frozen=True)
class Calibration:
    """Of n joints."""

    noise: FloatArray  # (n,) [N² m²], a σ²
    spread: FloatArray  # (n,), b
    farthest: FloatArray  # (n,) [N² m²], leverage from which on motion is outside

    def std(self, leverage: FloatArray) -> FloatArray:
        """Return standard deviations (T, n) [N m]."""
        return np.sqrt(self.noise + self.spread * leverage)

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
    """Return errors (T,) [N m] and leverages (T,) [N² m²] of one joint's rows."""
    error, leverage = judged.residual[:, joint].copy(), np.zeros(judged.fold.size)
    for fold, fit in enumerate(without):
        rows = judged.fold == fold
        x = judged.columns[joint, rows].astype(np.float64)
        error[rows] -= x @ fit.weights
        leverage[rows] = leverage_of(x, fit.root)
    return error, leverage


def _calibrate_joint(
    error: FloatArray, leverage: FloatArray, noise: float
) -> tuple[float, float, float]:
    def improbability(logs: FloatArray) -> float:
        variance = np.exp(logs[0]) * noise + np.exp(logs[1]) * leverage + _TINY
        return float(np.mean(np.log(variance) + error**2 / variance))

    found = minimize(improbability, np.zeros(2), method="Nelder-Mead")
    a, b = np.exp(found.x)
    std = np.sqrt(a * noise + b * leverage + _TINY)
    grow = (np.quantile(np.abs(error) / std, COVERAGE) / _DEVIATIONS) ** 2
    return grow * a * noise, grow * b, float(np.quantile(leverage, _INSIDE))
