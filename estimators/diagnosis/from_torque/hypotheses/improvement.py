"""Improvement: the given simulation with what was found written into it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from estimators.diagnosis.settings.hypotheses import REVISION
from estimators.rigid_body.dynamics.regressor import PER_LINK, parameters_of
from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.inertial import Inertial
from limo_driver.physics import Payload

if TYPE_CHECKING:
    from estimators.rigid_body.fitting.extent import Extent, Extents
    from limo_driver.physics import Effect, Hypothesis, Simulation
    from limo_driver.types import FloatArray

Enter: TypeAlias = Callable[["Improvement", "FloatArray"], None]  # of fitted coefficients


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
        self.effects[place] = effect.with_value(name, float(np.clip(value, *_within(known))))

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


def _within(known: Any) -> tuple[float, float]:  # noqa: ANN401  # Parameter
    return known.lower, known.upper


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
