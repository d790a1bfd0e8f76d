"""Responses: what an effect of the catalogue would add to the recorded torque.

Torque effects are evaluated over the recording as `predict` does. What moves the link, turns
gravity or acts on the sensor is taken to first order around the given simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence  # noqa: TC003  # read by NamedTuple, singledispatch
from dataclasses import replace
from functools import partial, singledispatch
from typing import NamedTuple

import numpy as np

from estimators.diagnosis.from_torque.residuals.observations import (
    Observations,  # read by singledispatch
)
from limo_driver.physics import TimeDelay
from limo_driver.physics.effect import (
    ArmEffect,
    BodyEffect,
    Effect,
    JointEffect,
    MotionEffect,
    SensedTorque,
    SensorEffect,
    TorqueEffect,
)
from limo_driver.physics.simulation import displaced
from limo_driver.types import FloatArray  # noqa: TC001  # read by singledispatch


class Response(NamedTuple):
    """One column."""

    joints: tuple[int, ...]  # 0-based, on which it acts
    values: FloatArray  # (len(joints), K) [N m], filtered


class Sharp(NamedTuple):
    """Signals to filter for a column, and the function that makes the column of them."""

    values: FloatArray  # (T, m)
    read: Callable[[FloatArray], Response]  # from the filtered values on the slow rows, (K, m)


def response(effect: Effect, observed: Observations) -> Response:
    """Return what one effect adds, on the slow rows."""
    return responses((effect,), observed)[0]


def responses(effects: Sequence[Effect], observed: Observations) -> list[Response]:
    """Return what each of several effects adds; one pass of the filter serves all."""
    parts = [sharp(effect, observed) for effect in effects]
    filtered = observed.filter_together([part.values for part in parts])
    ends = np.cumsum([part.values.shape[1] for part in parts])[:-1]
    own = np.split(filtered, ends, axis=1)
    found = [part.read(values) for part, values in zip(parts, own, strict=True)]
    return [_sensed(effect, item, observed) for effect, item in zip(effects, found, strict=True)]


def _sensed(effect: Effect, found: Response, observed: Observations) -> Response:
    """Return a response as late as the torque sensors tell it, unless it is that of a sensor."""
    late = {j - 1 for e in observed.reference.effects if isinstance(e, TimeDelay) for j in e.joints}
    if isinstance(effect, SensorEffect) or late.isdisjoint(found.joints):
        return found
    rows = [
        observed.sensed(row, joint) for row, joint in zip(found.values, found.joints, strict=True)
    ]
    return Response(found.joints, np.stack(rows))


def stacked(found: Sequence[Response], rows: int) -> tuple[tuple[int, ...], FloatArray]:
    """Return the joints on which any of c responses acts, and their values there, (J, rows, c)."""
    joints = tuple(sorted({joint for item in found for joint in item.joints}))
    values = np.zeros((len(joints), rows, len(found)))
    for column, item in enumerate(found):
        for row, joint in zip(item.values, item.joints, strict=True):
            values[joints.index(joint), :, column] = row
    return joints, values


def difference(ahead: Effect, behind: Effect, observed: Observations) -> Response:
    """Return what one effect adds more than another of its kind; filtered once."""
    more, less = sharp(ahead, observed), sharp(behind, observed)
    if more.values.shape[1]:
        return _sensed(ahead, more.read(observed.filter(more.values - less.values)), observed)
    a, b = more.read(more.values), less.read(less.values)  # filtered already
    if a.joints != b.joints:
        raise AssertionError("an effect acts on the same joints whatever its size")
    return _sensed(ahead, Response(a.joints, a.values - b.values), observed)


@singledispatch
def sharp(effect: Effect, observed: Observations) -> Sharp:  # noqa: ARG001  # dispatched on
    """Return what one effect adds before the filter."""
    raise TypeError(f"no response is known for {type(effect).__name__}")


@sharp.register
def _(effect: TorqueEffect, observed: Observations) -> Sharp:
    return _own(effect, over_joint(effect, observed))


@sharp.register
def _(effect: SensorEffect, observed: Observations) -> Sharp:
    torque = _reaching(effect, observed)
    values = [
        effect.advance(
            effect.initial_state(), SensedTorque(observed.motion.time[rows], torque[rows])
        )[0]
        for rows in observed.segments
    ]
    return _own(effect, np.concatenate(values))


def _reaching(effect: SensorEffect, observed: Observations) -> FloatArray:
    """Return the torque (T, n) [N m] that reaches an effect, without what the same one makes of it.

    The columns may be around a simulation that has it already.
    """
    around = observed.reference
    others = tuple(item for item in around.effects if item.place != effect.place)
    if len(others) == len(around.effects):
        return observed.predicted
    return observed.predict(replace(around, effects=others))


@sharp.register
def _(effect: ArmEffect, observed: Observations) -> Sharp:
    values = [effect.advance(effect.initial_state(), arm)[0] for arm in observed.arms]
    return Sharp(np.concatenate(values), acting)


@sharp.register
def _(effect: BodyEffect, observed: Observations) -> Sharp:
    """Evaluate on the slow motion, which needs no filter."""
    body, slow = observed.reference.body, observed.slow
    motion = slow.position, slow.velocity, slow.acceleration
    change = effect.body(body).inverse_dynamics(*motion) - body.inverse_dynamics(*motion)
    return ready(acting(change), observed)


@sharp.register
def _(effect: MotionEffect, observed: Observations) -> Sharp:
    if not effect.displaces:
        return _own(effect, over_joint(effect, observed))
    joint = effect.joint - 1
    slope, inertia = observed.stiffness[joint], observed.inertia[joint]
    angle = over_joint(effect, observed)
    ahead = np.zeros_like(angle)
    for rows in observed.segments if effect.agility else ():
        own = displaced(
            observed.motion.time[rows], angle[rows, None], effect.agility * observed.bandwidth
        )
        ahead[rows] = own.second[:, 0]
    return Sharp(np.stack([angle, ahead], axis=1), partial(_moved, slope, inertia))


def over_joint(effect: TorqueEffect | MotionEffect, observed: Observations) -> FloatArray:
    """Evaluate an effect over all samples, its memory anew in each stretch; (T,)."""
    return np.concatenate(
        [effect.advance(effect.initial_state(), own)[0] for own in observed.seen_by(effect)]
    )


def _own(effect: JointEffect, values: FloatArray) -> Sharp:
    return Sharp(values[:, None], partial(_on, (effect.joint - 1,)))


def _on(joints: tuple[int, ...], values: FloatArray) -> Response:
    return Response(joints, values.T)


def _moved(slope: FloatArray, inertia: FloatArray, values: FloatArray) -> Response:
    """Return what the rigid body adds where a link is displaced, (K, 2) [rad], [rad/s²]."""
    return acting(-(values[:, :1] * slope.T + values[:, 1:] * inertia.T))


def ready(values: Response, observed: Observations) -> Sharp:
    """Wrap a response that needs no filter."""
    return Sharp(np.zeros((len(observed.motion), 0)), partial(_regardless, values))


def _regardless(values: Response, _nothing: FloatArray) -> Response:
    return values


def acting(values: FloatArray) -> Response:
    """Leave out the joints on which nothing acts; (K, n) [N m]."""
    joints = tuple(np.flatnonzero(np.abs(values).max(axis=0) > 0).tolist()) or (0,)
    return Response(joints, values.T[list(joints)])
