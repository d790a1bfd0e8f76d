"""Noise: how the residual would look if the simulation were right.

Errors of a torque sensor are correlated in time. Taken for white, any slow wave in them becomes a
discovery. Each joint's errors are an autoregression on the slow grid, and everything is compared
after whitening with it.

Source: Box, Jenkins and Reinsel, "Time Series Analysis", 1994, ch. 7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.residuals import NOISE
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

_MAD = 1.4826  # of a normal distribution, its deviation over the median of absolute values


@dataclass(frozen=True)
class Noise:
    """Errors of n joints on K rows; row t of a run of used rows is predicted from those before."""

    weight: FloatArray  # (n, order + 1, order): of the last rows, for each number of them known
    white: FloatArray  # (n, order + 1) standard deviation of the prediction error [N m]
    known: NDArray[np.int64]  # (K, n) rows before, at most the order, in the same run

    @classmethod
    def of(
        cls,
        residual: FloatArray,
        use: NDArray[np.bool_],
        segment: NDArray[np.int64],
        least: float = NOISE.tiny,
    ) -> Noise:
        """Fit an autoregression to each joint.

        Args:
            residual: Errors, (K, n) [N m].
            use: Rows that count, (K, n).
            segment: Of each row, (K,); no error is predicted from those of another.
            least: Deviation of any noise [N m].
        """
        n = residual.shape[1]
        weight, white = np.zeros((n, NOISE.order + 1, NOISE.order)), np.zeros((n, NOISE.order + 1))
        known = _known(use, segment)
        for j in range(n):
            weight[j], white[j] = _levinson(
                _covariance(residual[:, j], use[:, j], known[:, j], least)
            )
        return cls(weight, np.maximum(white, least), known)

    def larger(self, factor: FloatArray) -> Noise:
        """Return errors that are alike in time, and larger by a factor of each joint (n,)."""
        return replace(self, white=self.white * factor[:, None])

    def over(self, use: NDArray[np.bool_], segment: NDArray[np.int64]) -> Noise:
        """Return errors that look the same on other rows, (K, n), within segments (K,)."""
        return replace(self, known=_known(use, segment))

    @classmethod
    def independent(cls, deviation: FloatArray, use: NDArray[np.bool_]) -> Noise:
        """Return white noise of given deviations (n,) [N m] on rows (K, n)."""
        n = deviation.size
        white = np.repeat(deviation[:, None], NOISE.order + 1, axis=1)
        return cls(
            np.zeros((n, NOISE.order + 1, NOISE.order)), white, np.zeros(use.shape, dtype=np.int64)
        )

    def whiten(
        self, values: FloatArray, joint: int, use: NDArray[np.bool_] | None = None
    ) -> FloatArray:
        """Whiten one joint's errors or columns, (K, ...), to unit variance.

        Returns:
            All rows, or those in `use` (K,).
        """
        wanted = np.arange(values.shape[0]) if use is None else np.flatnonzero(use)
        columns = np.ascontiguousarray(values.reshape(values.shape[0], -1).T)
        known = self.known[wanted, joint]
        white = _whitened(columns, wanted, known, self.weight[joint], self.white[joint])
        return white.T.reshape(wanted.size, *values.shape[1:])


@compiled(reads=("columns", "weight", "white"), nogil=True, error_model="numpy")
def _whitened(
    columns: FloatArray,
    wanted: NDArray[np.int64],
    known: NDArray[np.int64],
    weight: FloatArray,
    white: FloatArray,
) -> FloatArray:
    """Return the prediction errors of columns (p, K) over their deviation on R rows, (p, R).

    Run after run of rows of which equally many before are known.
    """
    result = np.empty((columns.shape[0], wanted.size))
    first = 0
    while first < wanted.size:
        order, row, end = known[first], wanted[first], first + 1
        while end < wanted.size and known[end] == order and wanted[end] - end == row - first:
            end += 1
        size = end - first
        for p in range(columns.shape[0]):
            errors, given = result[p, first:end], columns[p, row : row + size]
            for i in range(size):
                errors[i] = given[i]
            for lag in range(1, order + 1):
                before = columns[p, row - lag : row - lag + size]
                for i in range(size):
                    errors[i] -= weight[order, lag - 1] * before[i]
            for i in range(size):
                errors[i] /= white[order]
        first = end
    return result


def _known(use: NDArray[np.bool_], segment: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the used rows right before each row in its segment, up to the order; (K, n)."""
    known = np.zeros(use.shape, dtype=np.int64)
    unbroken = np.ones(use.shape, dtype=bool)
    for lag in range(1, NOISE.order + 1):
        before = np.zeros(use.shape, dtype=bool)
        before[lag:] = use[:-lag] & (segment[lag:] == segment[:-lag])[:, None]
        unbroken &= before
        known += unbroken
    return known


def _covariance(
    residual: FloatArray, use: NDArray[np.bool_], known: NDArray[np.int64], least: float
) -> FloatArray:
    """Return the covariance of errors 0 to `order` rows apart, (order + 1,) [N² m²]."""
    result = np.zeros(NOISE.order + 1)
    for lag in range(NOISE.order + 1):
        rows = np.flatnonzero(use & (known >= lag))
        if rows.size:
            result[lag] = float(np.mean(residual[rows] * residual[rows - lag]))
    result[0] = result[0] * (1.0 + NOISE.ridge) + least**2
    return result


def _levinson(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Solve for the best linear prediction from 0 to `order` rows, one order after the other."""
    weight, white = np.zeros((NOISE.order + 1, NOISE.order)), np.zeros(NOISE.order + 1)
    variance = float(covariance[0])
    white[0] = np.sqrt(variance)
    for order in range(1, NOISE.order + 1):
        last = weight[order - 1, : order - 1]
        reflection = (covariance[order] - last @ covariance[order - 1 : 0 : -1]) / variance
        reflection = float(np.clip(reflection, -NOISE.strongest, NOISE.strongest))
        weight[order, : order - 1] = last - reflection * last[::-1]
        weight[order, order - 1] = reflection
        variance *= 1.0 - reflection**2
        white[order] = np.sqrt(variance)
    return weight, white


def roughness(
    residual: FloatArray, use: NDArray[np.bool_], least: float = NOISE.tiny
) -> FloatArray:
    """Return what changes from row to row in residuals (K, n), as a white deviation; (n,) [N m].

    Third differences leave nothing of what changes slowly; a lower bound of the noise, which is
    `least` [N m] at least.
    """
    rough = np.diff(residual, n=3, axis=0)
    rows = use[3:] & use[2:-1] & use[1:-2] & use[:-3]
    energy = np.sum(np.where(rows, rough, 0.0) ** 2, axis=0) / np.maximum(rows.sum(axis=0), 1)
    return np.maximum(np.sqrt(energy / _THIRD), least)


_THIRD = 20.0  # variance of a third difference of white noise


def usual_error(errors: FloatArray) -> float:
    """Return the deviation of most errors [N m], whatever a few of them are."""
    usual = _MAD * float(np.median(np.abs(errors))) if errors.size else 0.0
    return max(usual, np.finfo(float).tiny)


def usual_errors(errors: FloatArray, use: NDArray[np.bool_]) -> FloatArray:
    """Return the same of each joint (n,), by the rows (K, n) of its errors (K, n) that count."""
    return np.array([usual_error(errors[rows, j]) for j, rows in enumerate(use.T)])
