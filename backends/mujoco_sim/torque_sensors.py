"""Sensors of a simulated robot: torque, and the noise of all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from backends.mujoco_sim import layout
from limo_driver.physics import SensorEffect
from limo_driver.physics.effect import JointMotion, SensedTorque
from limo_driver.physics.effects.sensing import quantise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import TorqueEffect
    from limo_driver.types import FloatArray

_BLOCK = 256  # rows


class TorqueSensors:
    """Drift, gain, crosstalk and delay of the torque sensors.

    Args:
        effects: Drifts, which come first, and sensor effects in their order.
        resolution: Of each sensor, (n,) [N m].
    """

    def __init__(
        self, effects: Sequence[SensorEffect | TorqueEffect], resolution: FloatArray
    ) -> None:
        self.effects = sorted(effects, key=lambda effect: isinstance(effect, SensorEffect))
        self.resolution = resolution
        self._states = [effect.initial_state() for effect in self.effects]

    def __bool__(self) -> bool:
        return bool(self.effects)

    def sense(self, time: FloatArray, noise: FloatArray, log: FloatArray) -> None:
        """Write what the sensors say of T cycles into their log.

        Args:
            time: Of each cycle, (T,) [s].
            noise: Of the sensors, (T, n) [N m].
            log: Read and changed, (T, 7, n).
        """
        torque = log[:, layout.TRUE_TORQUE]
        for index, effect in enumerate(self.effects):
            j, state = effect.joint - 1, self._states[index]
            if isinstance(effect, SensorEffect):
                added, state = effect.advance(state, SensedTorque(time, torque))
            else:
                added, state = effect.advance(state, _motion(time, log[:, :, j]))
            torque[:, j] += added
            self._states[index] = state
        log[:, layout.MEASURED_TORQUE] = quantise(torque + noise, self.resolution)

    def save(self) -> object:
        """Return a copy of all memories."""
        return [state.copy() for state in self._states]

    def restore(self, saved: Any) -> None:  # noqa: ANN401  # what save returned
        """Go back to what `save` returned."""
        self._states = [state.copy() for state in saved]


def _motion(time: FloatArray, log: FloatArray) -> JointMotion:
    """Return the true motion of one joint from its log, (T, 7)."""
    return JointMotion(
        time,
        log[:, layout.TRUE_POSITION],
        log[:, layout.TRUE_VELOCITY],
        log[:, layout.TRUE_ACCELERATION],
        log[:, layout.TRUE_TORQUE],
    )


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
