"""Fitted network: what training gives, and how it is fed."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Any

    from numpy.typing import NDArray

    from estimators.hybrid.features import Features
    from estimators.hybrid.scaling import InputScaling, Scaling
    from estimators.neural import Network
    from limo_driver.types import FloatArray

_RATE_TOLERANCE: Final = 0.1  # of the network's rate; beyond it, its memory runs at another speed


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
