"""White noise of the torque sensors, drawn ahead in blocks and the same in whatever portions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_BLOCK = 256  # rows


class SensorNoise:
    """A reproducible source of Gaussian rows.

    Args:
        deviation: Standard deviation of each joint, (n,) [N m].
        seed: Seed.
    """

    def __init__(self, deviation: FloatArray, seed: int) -> None:
        self.deviation = np.array(deviation)
        self._random = np.random.default_rng(seed)
        self._draw()

    def take(self, count: int) -> FloatArray:
        """Return the next `count` rows, (count, n) [N m]."""
        if self._used + count <= _BLOCK:
            self._used += count
            return self._block[self._used - count : self._used]
        parts = [self._block[self._used :]]
        missing = count - len(parts[0])
        while missing > 0:
            self._draw()
            parts.append(self._block[:missing])
            self._used = min(missing, _BLOCK)
            missing -= _BLOCK
        return np.concatenate(parts)

    def save(self) -> object:
        """Return where the source stands."""
        return self._before, self._used

    def restore(self, saved: Any) -> None:  # noqa: ANN401  # what save returned
        """Go back to what `save` returned."""
        self._random.bit_generator.state, used = saved
        self._draw()
        self._used = used

    def _draw(self) -> None:
        self._before = self._random.bit_generator.state
        rows = self._random.standard_normal((_BLOCK, self.deviation.size))
        self._block = rows * self.deviation
        self._used = 0
