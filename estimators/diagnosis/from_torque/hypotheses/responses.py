"""The torque that each hypothesis would add, and how much evidence improves with it.

Responses: what an effect of the catalogue would add to the recorded torque.

Torque effects are evaluated over the recording as `predict` does. What moves the link, turns
gravity or acts on the sensor is taken to first order around the given simulation.
"""

from __future__ import annotations

from collections.abc import (
    Callable,  # read by NamedTuple, singledispatch
    Sequence,  # read by NamedTuple, singledispatch
)
from dataclasses import replace
from functools import partial, singledispatch
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from estimators.diagnosis.from_torque.residuals.observations import (
    Observations,  # read by singledispatch
)
from estimators.diagnosis.settings.fitting import REVISION
from estimators.rigid_body.regressor import PER_LINK, parameters_of
from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import Payload, TimeDelay
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
from limo_driver.types import FloatArray  # read by singledispatch

if TYPE_CHECKING:
    from estimators.rigid_body.fitting.extent import Extent, Extents
    from limo_driver.physics import Hypothesis, Simulation

Enter: TypeAlias = Callable[["Improvement", "FloatArray"], None]  # of fitted coefficients


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
    # what reaches the sensor, even where the columns are around a simulation that has it already
    torque = observed.predicted_without(effect.place)
    values = [
        effect.advance(
            effect.initial_state(), SensedTorque(observed.motion.time[rows], torque[rows])
        )[0]
        for rows in observed.segments
    ]
    return _own(effect, np.concatenate(values))


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
    by = effect.evaluate if isinstance(effect, TorqueEffect) else effect.advance
    return np.concatenate([by(effect.initial_state(), own)[0] for own in observed.seen_by(effect)])


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


class Improvement:
    """Collects changes to a simulation.

    Args:
        simulation: What is changed.
        extents: In which the mass of its bodies lies; anywhere if not given.
    """

    def __init__(self, simulation: Simulation, extents: Extents | None = None) -> None:
        self.given, self.extents = simulation, extents
        self.effects: list[Effect] = list(simulation.effects)
        self.change = np.zeros(
            (simulation.model.linkage.links, PER_LINK)
        )  # of (m, m c, I) of each link

    def revise(self, place: int, name: str, relative: float) -> None:
        """Add a fraction of its given value to a parameter of the effect at a place in the list."""
        effect: Any = self.effects[place]
        known = next(item for item in effect.parameters() if item.name == name)
        value = getattr(effect, name) + relative * getattr(self.given.effects[place], name)
        self.effects[place] = effect.with_value(
            name, float(np.clip(value, known.lower, known.upper))
        )

    def move_inertia(self, link: int, change: FloatArray) -> None:
        """Add to the parameters (m, m c, I at the joint frame) of a link (0-based)."""
        self.change[link] += change

    def add(self, effect: Effect) -> None:
        """Add an effect, or add it to the same effect of the same joint."""
        for place, old in enumerate(self.effects):
            merged = old.with_more(effect)
            if merged is not None:
                self.effects[place] = merged
                return
        self.effects.append(effect)

    def enter(self, hypothesis: Hypothesis, coefficients: FloatArray) -> None:
        """Enter a hypothesis with fitted coefficients."""
        if hypothesis.enter is not None:
            self.effects = list(hypothesis.enter(self.effects, coefficients))
            return
        for effect in hypothesis.realise(coefficients):
            self.add(effect)

    def simulation(self) -> Simulation:
        """Return the simulation; bodies that cannot be are drawn back to the nominal ones."""
        model = self.given.model
        inertials = dict(self.given.inertials)
        for link, (name, change) in enumerate(zip(model.link_names, self.change, strict=True)):
            if change.any():
                extent = self.extents and self.extents.of(link)
                inertials[name] = _body(model.inertials[name], change, extent)
        return replace(self.given, effects=tuple(self.effects), inertials=inertials)


def _body(nominal: Inertial, change: FloatArray, extent: Extent | None) -> Inertial:
    """Return a possible body with the changed mass and centre of mass.

    Those are what gravity reveals. The inertia gives way towards the nominal one, with the mass.
    What would have to be where the arm is not goes no farther than that: all gives way.
    """
    own = parameters_of(nominal)
    if extent is None or not extent.holds(own):  # where the nominal one is not, nobody knows
        return _consistent(nominal, own + change) or nominal
    part = extent.part(own, change)
    for _ in range(REVISION.shorter):
        body = _consistent(nominal, own + part * change)
        if body is not None and extent.holds(parameters_of(body)):
            return body
        part *= 0.5
    return nominal


def _consistent(nominal: Inertial, parameters: FloatArray) -> Inertial | None:
    body = body_of(parameters)
    if body is None:
        return None
    rigid = np.array(nominal.inertia) * body.mass / nominal.mass
    for part in np.linspace(0.0, 1.0, REVISION.steps):
        mixed = (1.0 - part) * np.array(body.inertia) + part * rigid
        possible = replace(body, inertia=tuple(mixed.tolist()))
        if possible.is_consistent():
            return possible
    return None


def body_of(parameters: FloatArray) -> Inertial | None:
    """Return the body of (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz); None without mass."""
    m = float(parameters[0])
    if m <= 0:
        return None
    c = parameters[1:4] / m
    xx, xy, yy, xz, yz, zz = parameters[4:]
    origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    tensor = origin - m * (c @ c * np.eye(3) - np.outer(c, c))
    x, y, z = (float(value) for value in c)
    inertia = tuple(float(value) for value in tensor[np.triu_indices(3)])
    return Inertial(m, (x, y, z), inertia)  # pyright: ignore[reportArgumentType]  # six numbers


def beyond(extents: Extents, effect: Effect) -> bool:
    """Say whether an effect is a load that is farther away than one can be."""
    if not isinstance(effect, Payload):
        return False
    last = extents.model.linkage.links - 1
    return not extents.of(last).holds(parameters_of(effect.load))


def payload_of(parameters: FloatArray) -> Payload:
    """Return the payload of (m, m c, I) in the frame of the last link.

    Raises:
        ConfigError: No body has these parameters, even as a point.
    """
    body = body_of(parameters)
    if body is None:
        raise ConfigError("a payload has to have mass")
    if not body.is_consistent():
        size = 2 / 5 * body.mass * REVISION.compact**2  # of a ball
        body = replace(body, inertia=(size, 0.0, 0.0, size, 0.0, size))
    return Payload(mass=body.mass, com=body.com, inertia=body.inertia)
