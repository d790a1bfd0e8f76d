"""Sensor effects on the torque log: computed after the run, without influence on the motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from backends.mujoco_sim import layout
from limo_driver.physics import SensorEffect
from limo_driver.physics.effect import JointMotion, SensedTorque
from limo_driver.physics.effects.sensing import quantise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import TorqueEffect
    from limo_driver.types import FloatArray


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
