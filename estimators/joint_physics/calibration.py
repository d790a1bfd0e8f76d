"""How far a fit is off on motion that it was not fitted to, and from where on nobody knows.

    variance of the error = c (σ² + x Σ xᵀ)

with the noise σ² and the covariance Σ of the weights, that of their posterior and that of the
jackknife. The factor c of each joint is such that 95 % of the errors on folds left out are within
1.96 standard deviations (split conformal prediction) by the posterior alone: those folds took part
in the jackknife, and other motion is less like the data than they are. Folds of a short recording
are alike: while one has fewer rows than there are weights, c is at least 1, so that they may widen
the interval but not narrow it. Motion whose leverage x Σ xᵀ
shows beside the noise and is beyond nearly all of what the folds were judged on is outside: the
formula still grows there, but no error confirms it.

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

    from estimators.joint_physics.evidence import Fit
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

    def std(self, leverage: FloatArray, unknown: FloatArray) -> FloatArray:
        """Return standard deviations [N m] of leverages, and of variances by memory, (T, n)."""
        return np.sqrt(self.factor * (self.noise + leverage) + unknown)

    def outside(self, leverage: FloatArray) -> NDArray[np.bool_]:
        """Return which motion is outside what was judged, (T, n)."""
        return leverage > self.farthest


def calibrate(judged: JudgedRows, fits: Sequence[Fit], count: FloatArray) -> Calibration:
    """Judge each joint's fits without a fold on the rows of that fold.

    Args:
        judged: Rows of all folds.
        fits: Of each joint.
        count: Rows that each fold has of each joint, (F, n).
    """
    least = [0.0 if enough else 1.0 for enough in (count >= judged.columns.shape[2]).all(axis=0)]
    found = [
        _calibrate_joint(*_judge(judged, fit, j), fit.prior.noise, least[j])
        for j, fit in enumerate(fits)
    ]
    return Calibration(*(np.array(values) for values in zip(*found, strict=True)))


def leverage_of(x: FloatArray, root: FloatArray) -> FloatArray:
    """Return x Σ xᵀ of rows (T, K), the variance that unsure weights give the torque, (T,)."""
    return np.sum((x @ root.T) ** 2, axis=1)


def _judge(judged: JudgedRows, fit: Fit, joint: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return errors [N m] of one joint's settled rows, and what leverages are made of [N² m²].

    These are the leverages by the posterior, and what the jackknife adds to them.
    """
    error, leverage = judged.residual[:, joint].copy(), np.zeros(judged.fold.size)
    added = np.zeros(judged.fold.size)
    for fold, without in enumerate(fit.without):
        rows = judged.fold == fold
        x = judged.columns[joint, rows].astype(np.float64)
        error[rows] -= x @ without.weights
        leverage[rows], added[rows] = leverage_of(x, without.root), leverage_of(x, fit.spread)
    settled = judged.settled[:, joint]
    return error[settled], leverage[settled], added[settled]


def _calibrate_joint(
    error: FloatArray, leverage: FloatArray, added: FloatArray, noise: float, least: float
) -> tuple[float, float, float]:
    """Return noise, factor and farthest leverage of one joint."""
    deviations = np.abs(error) / np.sqrt(noise + leverage)
    factor = float(np.quantile(deviations, COVERAGE) / DEVIATIONS) ** 2
    farthest = max(float(np.quantile(leverage + added, _INSIDE)), _SHOWS * noise)
    return noise, max(factor, least), farthest
