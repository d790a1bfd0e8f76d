"""Effects without a native form: run through their own `advance`, one sample in each cycle."""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatchmethod
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from backends.mujoco_sim import layout
from backends.mujoco_sim.drives import away_from_rest
from limo_driver.physics import ArmEffect, Friction, JointCoupling, MotionEffect, TorqueEffect
from limo_driver.physics.effect import ArmMotion
from limo_driver.types import Motion

if TYPE_CHECKING:
    from backends.mujoco_sim.realisation import Draft
    from limo_driver.model import RobotModel
    from limo_driver.physics import Effect
    from limo_driver.physics.effect import State
    from limo_driver.types import FloatArray


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
            if isinstance(effect, MotionEffect) and effect.displaces:
                self._add(effect, state, _Cycle(arm, rest, rest, rest, load.copy(), rest))
        self._last_static = self.added[layout.ADDED_STATIC_WIND_UP].copy()

    @singledispatchmethod
    def _add(self, effect: Effect, state: State, cycle: _Cycle) -> State:  # noqa: ARG002
        """Add what an effect does in the cycle, and return its memory after it."""
        raise TypeError(f"the simulated robot has no form for {type(effect).__name__}")

    @_add.register(TorqueEffect)
    def _(self, effect: TorqueEffect, state: State, cycle: _Cycle) -> State:
        j = effect.joint - 1
        value, state = effect.evaluate(state, cycle.arm.of_joint(j))
        self.added[layout.ADDED_TORQUE, j] += value[0]
        return state

    @_add.register(Friction)
    def _(self, effect: Friction, state: State, cycle: _Cycle) -> State:
        return self._damp(effect, state, cycle)

    def _damp(self, effect: Friction | MotionEffect, state: State, cycle: _Cycle) -> State:
        """Add a torque that has the sign of the velocity, or its opposite, as a damping."""
        j = effect.joint - 1
        v = away_from_rest(cycle.ahead[j])
        sliding = replace(cycle.arm.of_joint(j), velocity=np.array([v]))
        by = effect.evaluate if isinstance(effect, Friction) else effect.advance
        value, state = by(state, sliding)
        self.added[layout.ADDED_DAMPING, j] += value[0] / v
        return state

    @_add.register(MotionEffect)
    def _(self, effect: MotionEffect, state: State, cycle: _Cycle) -> State:
        if not effect.displaces:
            return self._damp(effect, state, cycle)
        j = effect.joint - 1
        motion = cycle.arm.of_joint(j)
        at_rest = replace(motion, load=cycle.static[j : j + 1])
        self.added[layout.ADDED_STATIC_WIND_UP, j] += effect.advance(state, at_rest)[0][0]
        value, state = effect.advance(state, motion)
        self.added[layout.ADDED_WIND_UP, j] += value[0]
        return state

    @_add.register(ArmEffect)
    def _(self, effect: ArmEffect, state: State, cycle: _Cycle) -> State:
        values, state = effect.advance(state, cycle.arm)
        self.added[layout.ADDED_TORQUE] += values[0]
        return state

    @_add.register(JointCoupling)
    def _(self, effect: JointCoupling, state: State, cycle: _Cycle) -> State:
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
