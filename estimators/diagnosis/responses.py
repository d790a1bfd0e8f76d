"""Responses: what an effect of the catalogue would add to the recorded torque.

Torque effects are evaluated over the recording as `predict` does. What moves the link, turns
gravity or acts on the sensor is taken to first order around the given simulation.
"""

from __future__ import annotations

from functools import singledispatch
from typing import NamedTuple

import numpy as np

from estimators.diagnosis.observations import Observations  # read by singledispatch
from limo_driver.differentiation import differentiate
from limo_driver.physics import JointElasticity
from limo_driver.physics.effect import (
    ArmEffect,
    ArmMotion,
    BodyEffect,
    Effect,
    JointMotion,
    MotionEffect,
    SensedTorque,
    SensorEffect,
    TorqueEffect,
)
from limo_driver.types import FloatArray  # noqa: TC001  # read by singledispatch


class Response(NamedTuple):
    """One column."""

    joints: tuple[int, ...]  # 0-based, on which it acts
    values: FloatArray  # (len(joints), K) [N m], filtered


@singledispatch
def response(effect: Effect, observed: Observations) -> Response:
    """Return what one effect adds, on the slow rows."""
    raise TypeError(f"no response is known for {type(effect).__name__}")


@response.register
def _(effect: TorqueEffect, observed: Observations) -> Response:
    return _own(effect, observed, _over_joint(effect, observed))


@response.register
def _(effect: SensorEffect, observed: Observations) -> Response:
    torque = observed.predicted
    values = [
        effect.advance(
            effect.initial_state(), SensedTorque(observed.motion.time[rows], torque[rows])
        )[0]
        for rows in observed.segments
    ]
    return _own(effect, observed, np.concatenate(values))


@response.register
def _(effect: ArmEffect, observed: Observations) -> Response:
    values = [
        effect.advance(
            effect.initial_state(),
            ArmMotion(observed.motion[rows], observed.load[rows], observed.simulation.body),
        )[0]
        for rows in observed.segments
    ]
    return _acting(observed.filter(np.concatenate(values)))


@response.register
def _(effect: BodyEffect, observed: Observations) -> Response:
    body, slow = observed.simulation.body, observed.slow
    motion = slow.position, slow.velocity, slow.acceleration
    return _acting(effect.body(body).inverse_dynamics(*motion) - body.inverse_dynamics(*motion))


@response.register
def _(effect: MotionEffect, observed: Observations) -> Response:
    displacement = _over_joint(effect, observed)
    filtered = observed.filter(displacement[:, None])[:, 0]
    return _acting(-(filtered * observed.stiffness[effect.joint - 1]).T)


@response.register
def _(effect: JointElasticity, observed: Observations) -> Response:
    j = effect.joint - 1
    displacement = _over_joint(effect, observed)
    filtered = observed.filter(displacement[:, None])[:, 0]
    values = -filtered * observed.stiffness[j] - _second(effect, observed) * observed.inertia[j]
    return _acting(values.T)


def _second(effect: JointElasticity, observed: Observations) -> FloatArray:
    """Return the second derivative of the deflection under gravity alone, (K,) [rad/s²].

    Under the full load it would be the fourth derivative of a measured position.
    """
    j, motion = effect.joint - 1, observed.motion
    load = observed.simulation.body.gravity_torque(motion.position)[:, j]
    still = np.zeros_like(load)
    result = np.empty_like(load)
    for rows in observed.segments:
        part = JointMotion(
            motion.time[rows], motion.position[rows, j], still[rows], still[rows], load[rows]
        )
        deflection = effect.advance(effect.initial_state(), part)[0][:, None]
        time = motion.time[rows]
        whole = [slice(0, time.size)]
        result[rows] = differentiate(time, deflection, observed.bandwidth, whole).second[:, 0]
    return result[observed.kept]


def _over_joint(effect: TorqueEffect | MotionEffect, observed: Observations) -> FloatArray:
    """Evaluate an effect over all samples, its memory anew in each stretch; (T,)."""
    return np.concatenate(
        [
            effect.advance(effect.initial_state(), observed.of_joint(effect.joint - 1, rows))[0]
            for rows in observed.segments
        ]
    )


def _own(
    effect: TorqueEffect | SensorEffect, observed: Observations, values: FloatArray
) -> Response:
    return Response((effect.joint - 1,), observed.filter(values[:, None]).T)


def _acting(values: FloatArray) -> Response:
    """Leave out the joints on which nothing acts; (K, n) [N m]."""
    joints = tuple(np.flatnonzero(np.abs(values).max(axis=0) > 0).tolist()) or (0,)
    return Response(joints, values.T[list(joints)])
