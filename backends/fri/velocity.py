"""Joint velocity from positions, as they come."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.runtime.compiled import compiled
from limo_driver.types import readonly

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
        self._position = self.velocity = readonly(np.zeros(n))  # (n,) [rad, rad/s]

    def update(self, time: float, position: FloatArray) -> None:
        """Take a sample: robot time [s], position (n,) [rad], read-only."""
        if self._time is not None:
            step = time - self._time
            if step > LONGEST_STEP:
                self.velocity = readonly(np.zeros(position.size))
            elif step > 0.0:
                velocity = np.empty(position.size)
                _filter(self.velocity, position, self._position, step, velocity)
                velocity.setflags(write=False)
                self.velocity = velocity
        self._time, self._position = time, position


@compiled(reads=("velocity", "position", "before"))
def _filter(
    velocity: FloatArray, position: FloatArray, before: FloatArray, step: float, after: FloatArray
) -> None:
    """Write the velocity [rad/s] after a step [s]."""
    share = step / (step + TIME_CONSTANT)
    for j in range(after.size):
        after[j] = (1.0 - share) * velocity[j] + (share / step) * (position[j] - before[j])
