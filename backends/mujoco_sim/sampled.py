"""What the simulated robot samples each cycle: effects without a native form, and its sensors.

Effects run through their own `advance`; sensors are of torque, with the noise of all.
"""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatchmethod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from backends.mujoco_sim import layout
from backends.mujoco_sim.realisation import away_from_rest
from limo_driver import physics
from limo_driver.physics.effect import ArmMotion, JointMotion, SensedTorque, State
from limo_driver.physics.effects.sensing import quantise
from limo_driver.types import FloatArray, Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.mujoco_sim.realisation import Draft
    from limo_driver.model import RobotModel


class _Cycle(NamedTuple):
    """Inputs of the effects before the step."""

    arm: ArmMotion  # one sample: the encoders', with the velocity expected at its time
    rate: FloatArray  # (n,) of motor against link [rad/s]
    motor: FloatArray  # (n,) velocity before the step [rad/s]
    ahead: FloatArray  # (n,) velocity expected in the step, for what damps it [rad/s]
    static: FloatArray  # (n,) gravity and Coriolis torque [N m]
    control: FloatArray  # of MuJoCo's actuators


class SampledEffects:
    """Contribution in one cycle of the effects without a native form.

    Frictions become a damping, so that stiff ones cannot reverse the motion; other torques act as
    they are, computed from the motion before the step. A displacement is also evaluated under the
    static load, for the servo: one that followed acceleration would close a loop within the step.

    Args:
        draft: Which effects to run, and constant displacements.
        model: Rigid body.
        period: Control cycle [s].
    """

    def __init__(self, draft: Draft, model: RobotModel, period: float) -> None:
        self.effects = tuple(draft.sampled)
        self.model, self.period = model, period
        self._always = np.zeros((4, model.n))
        self._always[layout.ADDED_WIND_UP] = draft.encoder_offset
        self._always[layout.ADDED_STATIC_WIND_UP] = draft.encoder_offset
        self.added = self._always.copy()  # see layout.ADDED_TORQUE and following
        self.acceleration = np.zeros(model.n)  # of the last cycle [rad/s²]
        self._last_static = draft.encoder_offset.copy()  # wind-up [rad]
        self._states = [effect.initial_state() for effect in self.effects]
        first = model.n + len(draft.elements)  # where MuJoCo's controls of the shafts begin
        self._shafts = {
            coupling: first + index
            for index, shaft in enumerate(draft.shafts)
            for coupling in (shaft, replace(shaft, joint=shaft.other, other=shaft.joint))
        }

    def __bool__(self) -> bool:
        return bool(self.effects)

    def sample(self, time: float, arrays: layout.Arrays, memory: FloatArray) -> None:
        """Evaluate all effects for the coming step.

        Args:
            time: Of the cycle [s].
            arrays: MuJoCo's, before the step.
            memory: The robot's, (9, n).
        """
        static = memory[layout.STATIC_WIND_UP]
        rate = (static - self._last_static) / self.period
        motor = arrays.velocity + rate
        self._last_static = static.copy()
        change = self.period * self.acceleration
        arm = self._arm(
            time,
            arrays.position + memory[layout.WIND_UP],
            motor + 0.5 * change,
            memory[layout.LOAD],
        )
        cycle = _Cycle(arm, rate, motor, motor + change, arrays.bias.copy(), arrays.control)
        self.added[:] = self._always
        for index, effect in enumerate(self.effects):
            self._states[index] = self._add(effect, self._states[index], cycle)

    def push(self, torque: FloatArray) -> None:
        """Lean on the links with a torque, (n,) [N m], until told otherwise."""
        self._always[layout.ADDED_TORQUE] = -torque  # what is added resists the motion
        self.added[layout.ADDED_TORQUE] = -torque

    def settle(self, position: FloatArray, load: FloatArray) -> None:
        """Evaluate displacements at rest, without touching any memory."""
        rest = np.zeros_like(position)
        arm = self._arm(0.0, position, rest, load)
        self.added[:] = self._always
        for effect, state in zip(self.effects, self._states, strict=True):
            if isinstance(effect, physics.MotionEffect) and effect.displaces:
                self._add(effect, state, _Cycle(arm, rest, rest, rest, load.copy(), rest))
        self._last_static = self.added[layout.ADDED_STATIC_WIND_UP].copy()

    @singledispatchmethod
    def _add(self, effect: physics.Effect, state: State, cycle: _Cycle) -> State:  # noqa: ARG002
        """Add what an effect does in the cycle, and return its memory after it."""
        raise TypeError(f"the simulated robot has no form for {type(effect).__name__}")

    @_add.register(physics.TorqueEffect)
    def _(self, effect: physics.TorqueEffect, state: State, cycle: _Cycle) -> State:
        j = effect.joint - 1
        value, state = effect.evaluate(state, cycle.arm.of_joint(j))
        self.added[layout.ADDED_TORQUE, j] += value[0]
        return state

    @_add.register(physics.Friction)
    def _damp(
        self, effect: physics.Friction | physics.MotionEffect, state: State, cycle: _Cycle
    ) -> State:
        """Add a torque that has the sign of the velocity, or its opposite, as a damping."""
        j = effect.joint - 1
        v = away_from_rest(cycle.ahead[j])
        sliding = replace(cycle.arm.of_joint(j), velocity=np.array([v]))
        by = effect.evaluate if isinstance(effect, physics.Friction) else effect.advance
        value, state = by(state, sliding)
        self.added[layout.ADDED_DAMPING, j] += value[0] / v
        return state

    @_add.register(physics.MotionEffect)
    def _(self, effect: physics.MotionEffect, state: State, cycle: _Cycle) -> State:
        j = effect.joint - 1
        if not effect.displaces:  # what it has wound up pushes whichever way the joint moves
            wound, _ = effect.advance(state, replace(cycle.arm.of_joint(j), velocity=np.zeros(1)))
            self.added[layout.ADDED_TORQUE, j] += wound[0]
            self.added[layout.ADDED_DAMPING, j] -= wound[0] / away_from_rest(cycle.ahead[j])
            return self._damp(effect, state, cycle)
        motion = cycle.arm.of_joint(j)
        at_rest = replace(motion, load=cycle.static[j : j + 1])
        self.added[layout.ADDED_STATIC_WIND_UP, j] += effect.advance(state, at_rest)[0][0]
        value, state = effect.advance(state, motion)
        self.added[layout.ADDED_WIND_UP, j] += value[0]
        return state

    @_add.register(physics.ArmEffect)
    def _(self, effect: physics.ArmEffect, state: State, cycle: _Cycle) -> State:
        values, state = effect.advance(state, cycle.arm)
        self.added[layout.ADDED_TORQUE] += values[0]
        return state

    @_add.register(physics.JointCoupling)
    def _(self, effect: physics.JointCoupling, state: State, cycle: _Cycle) -> State:
        """Damp by the secant of the shaft's friction.

        Where both joints feel the shaft, MuJoCo damps it, implicitly in both. Where only one does,
        that joint is damped, and the other's velocity is taken as it is before the step.
        """
        j, k = effect.joint - 1, effect.other - 1
        w = away_from_rest(effect.shaft(cycle.ahead[None])[0])
        damping = effect.friction(np.array([w]))[0] / w
        torque = effect.inertia * effect.shaft(self.acceleration[None])[0]
        if effect in self._shafts:
            cycle.control[self._shafts[effect]] = damping
            torque += damping * effect.shaft(cycle.rate[None])[0]
        else:
            self.added[layout.ADDED_DAMPING, j] += damping
            torque += damping * effect.ratio * cycle.motor[k]
        self.added[layout.ADDED_TORQUE, j] += torque
        return state

    def _arm(
        self, time: float, position: FloatArray, velocity: FloatArray, load: FloatArray
    ) -> ArmMotion:
        motion = Motion(
            np.array([time]), position[None], velocity[None], self.acceleration[None].copy()
        )
        return ArmMotion(motion, load[None].copy(), self.model)

    def save(self) -> object:
        """Return a copy of all memories."""
        states = [state.copy() for state in self._states]
        return self.added.copy(), self.acceleration.copy(), self._last_static.copy(), states

    def restore(self, saved: Any) -> None:  # noqa: ANN401  # what save returned
        """Go back to what `save` returned."""
        added, acceleration, static, states = saved
        self.added[:] = added
        self.acceleration, self._last_static = acceleration.copy(), static.copy()
        self._states = [state.copy() for state in states]


_BLOCK = 256  # rows


class TorqueSensors:
    """Drift, gain, crosstalk and delay of the torque sensors.

    Args:
        effects: Drifts, which come first, and sensor effects in their order.
        resolution: Of each sensor, (n,) [N m].
    """

    def __init__(
        self, effects: Sequence[physics.SensorEffect | physics.TorqueEffect], resolution: FloatArray
    ) -> None:
        self.effects = sorted(effects, key=lambda effect: isinstance(effect, physics.SensorEffect))
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
            if isinstance(effect, physics.SensorEffect):
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
