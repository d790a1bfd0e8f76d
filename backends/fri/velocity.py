"""Joint velocity from positions, as they come."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

TIME_CONSTANT: Final = 5e-3  # [s]
LONGEST_STEP: Final = 0.1  # [s]; beyond, the filter begins anew


class VelocityFilter:
    """Differences through a causal low-pass of first order, for any spacing of the samples.

    v += dt / (dt + T) ((q - q_before) / dt - v), with the time constant T = 5 ms: it lags by about
    T, and halves the amplitude at 55 Hz.

    Args:
        n: Number of joints.
    """

    def __init__(self, n: int) -> None:
        self._time: float | None = None
        self._position = np.zeros(n)
        self.velocity = np.zeros(n)  # (n,) [rad/s]

    def update(self, time: float, position: FloatArray) -> None:
        """Take a sample: robot time [s], position (n,) [rad]."""
        if self._time is not None:
            step = time - self._time
            if step > LONGEST_STEP:
                self.velocity = np.zeros(position.size)
            elif step > 0.0:
                share = step / (step + TIME_CONSTANT)
                self.velocity = (1.0 - share) * self.velocity + (share / step) * (
                    position - self._position
                )
        self._time, self._position = time, position
