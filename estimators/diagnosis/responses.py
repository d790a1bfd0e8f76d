"""Responses: what an effect of the catalogue would add to the recorded torque.

Torque effects are evaluated over the recording as `predict` does. What moves the link, turns
gravity or acts on the sensor is taken to first order around the given simulation.
"""

from __future__ import annotations

from dataclasses import replace
from functools import singledispatch
from typing import NamedTuple

import numpy as np

from estimators.diagnosis.observations import Observations  # read by singledispatch
from limo_driver.physics import JointElasticity
from limo_driver.physics.effect import (
    ArmEffect,
    ArmMotion,
    BodyEffect,
    Effect,
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
def response(effect: Effect, observed: Observations) -> Response:  # noqa: ARG001  # dispatched on
    """Return what one effect adds, on the slow rows."""
    raise TypeError(f"no response is known for {type(effect).__name__}")


@response.register
def _(effect: TorqueEffect, observed: Observations) -> Response:
    return _own(effect, observed, over_joint(effect, observed))


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
    displacement = over_joint(effect, observed)
    filtered = observed.filter(displacement[:, None])[:, 0]
    return _acting(-(filtered * observed.stiffness[effect.joint - 1]).T)


@response.register
def _(effect: JointElasticity, observed: Observations) -> Response:
    """Take the difference that the simulation itself makes: it includes the winding's motion."""
    given = observed.simulation
    more = replace(given, effects=(*given.effects, effect))
    return _acting(observed.filter(observed.predict(more) - observed.predicted))


def over_joint(effect: TorqueEffect | MotionEffect, observed: Observations) -> FloatArray:
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
