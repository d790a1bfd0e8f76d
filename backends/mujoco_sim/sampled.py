"""Effects without a native form: run through their own `advance`, one sample in each cycle."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from backends.mujoco_sim import layout
from limo_driver.physics import MotionEffect
from limo_driver.physics.effect import JointMotion
from limo_driver.physics.friction import VelocityFriction, secant

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Effect
    from limo_driver.types import FloatArray


class SampledEffects:
    """What the effects without a native form add in a cycle.

    Frictions become a damping, so that stiff ones cannot reverse the motion; other torques act as
    they are, computed from the motion before the step.

    Args:
        effects: Effects to run.
        n: Number of joints.
    """

    def __init__(self, effects: Sequence[Effect], n: int) -> None:
        self.effects = tuple(effects)
        self.added = np.zeros((4, n))  # see layout.ADDED_TORQUE and following
        self.acceleration = np.zeros(n)  # of the last cycle [rad/s²]
        self._states = [effect.initial_state() for effect in self.effects]

    def __bool__(self) -> bool:
        return bool(self.effects)

    def sample(self, arrays: layout.Arrays, load: FloatArray) -> None:
        """Evaluate all effects for the coming step.

        A displacement is also evaluated under the static load, for the servo: one that followed
        acceleration would close a loop within the step.
        """
        position = arrays.position + self.added[layout.ADDED_WIND_UP]
        velocity, acceleration = arrays.velocity, self.acceleration
        self.added[:] = 0.0
        for index, effect in enumerate(self.effects):
            state = self._states[index]
            motion = _sample(effect, position, velocity, acceleration, load)
            value, self._states[index] = effect.advance(state, motion)
            j = effect.joint - 1
            if isinstance(effect, MotionEffect):
                static = _sample(effect, position, velocity, acceleration, arrays.bias)
                self.added[layout.ADDED_WIND_UP, j] += value[0]
                self.added[layout.ADDED_STATIC_WIND_UP, j] += effect.advance(state, static)[0][0]
            elif isinstance(effect, VelocityFriction):
                self.added[layout.ADDED_DAMPING, j] += secant(effect, motion.velocity)[0]
            else:
                self.added[layout.ADDED_TORQUE, j] += value[0]

    def settle(self, position: FloatArray, load: FloatArray) -> None:
        """Evaluate displacements at rest, without touching any memory."""
        rest = np.zeros_like(position)
        self.added[:] = 0.0
        for effect, state in zip(self.effects, self._states, strict=True):
            if isinstance(effect, MotionEffect):
                motion = _sample(effect, position, rest, rest, load)
                value = effect.advance(state, motion)[0][0]
                self.added[layout.ADDED_WIND_UP, effect.joint - 1] += value
                self.added[layout.ADDED_STATIC_WIND_UP, effect.joint - 1] += value

    def save(self) -> object:
        """Return a copy of all memories."""
        return self.added.copy(), self.acceleration.copy(), [s.copy() for s in self._states]

    def restore(self, saved: Any) -> None:  # noqa: ANN401  # what save returned
        """Go back to what `save` returned."""
        added, acceleration, states = saved
        self.added[:] = added
        self.acceleration = acceleration.copy()
        self._states = [state.copy() for state in states]


def _sample(
    effect: Effect,
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    load: FloatArray,
) -> JointMotion:
    one = slice(effect.joint - 1, effect.joint)
    return JointMotion(
        np.zeros(1), position[one].copy(), velocity[one].copy(), acceleration[one].copy(), load[one].copy()
    )
