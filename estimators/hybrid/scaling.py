"""Normalisation of a network's inputs and of its torque."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

MEAN, STD, LOWEST, HIGHEST = 0, 1, 2, 3  # rows of the table of an `InputScaling`
_NONE = np.zeros((0, 0), np.int64)  # columns, where nobody asks how far they are beyond


@dataclass(frozen=True)
class Scaling:
    """Normalisation inside the model: x_norm = (x - mean) / std."""

    mean: FloatArray  # (d,)
    std: FloatArray  # (d,), above 0

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> Scaling:
        """Return mean and standard deviation of (T, d); a constant column gets std 1."""
        std = values.std(axis=0, dtype=np.float64)
        return cls(values.mean(axis=0, dtype=np.float64), np.where(std > 0, std, 1.0))

    def normalise(self, values: NDArray[np.floating]) -> FloatArray:
        """Return (T, d) without unit."""
        return (values - self.mean) / self.std

    def restore(self, values: FloatArray) -> FloatArray:
        """Invert `normalise`."""
        return values * self.std + self.mean


@dataclass(frozen=True)
class InputScaling(Scaling):
    """Normalisation of inputs, which first brings them into the range that training saw.

    A network has learned nothing outside: the clip bounds what it adds to the rigid body there.
    """

    lowest: FloatArray  # (d,)
    highest: FloatArray  # (d,)

    @classmethod
    def of(cls, values: NDArray[np.floating]) -> InputScaling:
        """Return mean, standard deviation and range of (T, d)."""
        scaling = Scaling.of(values)
        lowest, highest = (f(values, axis=0).astype(np.float64) for f in (np.min, np.max))
        return cls(scaling.mean, scaling.std, lowest, highest)

    @cached_property
    def table(self) -> FloatArray:
        """All four for compiled code, (4, d)."""
        return np.array([self.mean, self.std, self.lowest, self.highest], dtype=np.float64)

    def normalise(self, values: NDArray[np.floating]) -> FloatArray:
        """Return (T, d), clipped to the range, without unit."""
        inputs = np.array(values, dtype=np.float64)
        normalise_inputs(inputs, self.table, _NONE)
        return inputs


@compiled(reads=("table", "columns"), nogil=True)
def normalise_inputs(
    inputs: FloatArray, table: FloatArray, columns: NDArray[np.int64]
) -> FloatArray:
    """Clip and normalise inputs (T, d), in place, by the table (4, d) of an `InputScaling`.

    Returns:
        How far the farthest of the inputs `columns` (m, f) lay beyond its range, in standard
        deviations, (T, m).
    """
    beyond = np.zeros((inputs.shape[0], columns.shape[0]))
    for t in range(inputs.shape[0]):
        x = inputs[t]
        for j in range(columns.shape[0]):
            for i in columns[j]:
                excess = max(table[LOWEST, i] - x[i], x[i] - table[HIGHEST, i])
                beyond[t, j] = max(beyond[t, j], excess / table[STD, i])
        for i in range(x.size):
            inside = min(max(x[i], table[LOWEST, i]), table[HIGHEST, i])
            x[i] = (inside - table[MEAN, i]) / table[STD, i]
    return beyond
