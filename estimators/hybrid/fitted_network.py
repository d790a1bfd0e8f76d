"""Fitted network: what training gives, and how it is fed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, ModelStoreError
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from numpy.typing import NDArray

    from estimators.hybrid.features import Features
    from estimators.neural import Network
    from limo_driver.types import FloatArray

_RATE_TOLERANCE: Final = 0.1  # of the network's rate; beyond it, its memory runs at another speed
MEAN, STD, LOWEST, HIGHEST = 0, 1, 2, 3  # rows of the table of an `InputScaling`
_NONE = np.zeros((0, 0), np.int64)  # columns, where nobody asks how far they are beyond


@dataclass(frozen=True)
class FittedNetwork:
    """Result of training: a network, its features and their scaling."""

    features: Features
    network: Network
    inputs: InputScaling
    outputs: Scaling  # of the residual torque, or of the whole if it stands alone [N m]
    gain: FloatArray  # (n,) in [0, 1], how much of its torque carried over to motion held out
    rate: float  # rate of the samples that follow each other in the network's memory [Hz]
    bandwidth: float  # of the filters on motion and torque in training [Hz]
    record: Mapping[str, Any] = field(default_factory=dict)  # settings, data and metrics, as JSON
    standalone: bool = False  # no rigid-body torque goes into it or is added to it

    @cached_property
    def columns(self) -> NDArray[np.int64]:
        """Inputs that the network of each joint may use, (n, f)."""
        return self.features.columns

    @cached_property
    def error(self) -> FloatArray:
        """Root mean square error on motion not trained on, (n,) [N m]; NaN if there was none.

        On stretches left out whole if there were any, else on what was held out: blocks, which
        chose the weights that were kept, and whose neighbours are alike and were trained on.
        """
        rmse = self.record.get("rmse", {})
        known = rmse.get("left_out", rmse.get("held_out", {})).get("hybrid")
        return np.full(self.features.n, np.nan) if known is None else np.array(known)

    @cached_property
    def slope(self) -> FloatArray:
        """Torque by the network's output, (n,) [N m]."""
        return self.gain * self.outputs.std

    @cached_property
    def offset(self) -> FloatArray:
        """Torque where the network's output is zero, (n,) [N m]."""
        return self.gain * self.outputs.mean

    def stride(self, rate: float) -> int:
        """Return how many samples at `rate` [Hz] the network's memory spans at a time.

        Raises:
            ConfigError: The network has a memory, and the rate is no positive number.
            ModelStoreError: The network has a memory and its rate cannot be reached.
        """
        if not self.network.recurrent:
            return 1
        if not 0 < rate < np.inf:
            raise ConfigError(f"rate = {rate:g} Hz has to be above 0 and finite")
        stride = max(1, round(rate / self.rate))
        if abs(rate / stride / self.rate - 1.0) > _RATE_TOLERANCE:
            raise ModelStoreError(
                f"the model remembers at {self.rate:.4g} Hz, which samples at {rate:.4g} Hz cannot "
                f"give; train one at {rate / stride:.4g} Hz, or record at a multiple of its rate"
            )
        return stride


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
