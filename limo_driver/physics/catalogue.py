"""The catalogue: every effect by its identifier, limo's own and those of other distributions.

Other distributions register effects in the group `limo.effects` of entry points. One is imported
when a `sim.yaml` names it, and all of them when a diagnosis tries every effect.
"""

from __future__ import annotations

from functools import cache
from inspect import isabstract
from typing import Any

from limo_driver.errors import ConfigError, PlugInError
from limo_driver.physics.description import Confusion, Description
from limo_driver.physics.effect import (
    ArmEffect,
    BodyEffect,
    Effect,
    MotionEffect,
    SensorEffect,
    TorqueEffect,
)
from limo_driver.physics.effects import (
    arm,
    body,
    changing_friction,
    delay,
    friction,
    hysteresis,
    play,
    sensing,
    transmission,
)
from limo_driver.runtime.plugins import EFFECTS, PlugIn, names, plug_in

# limo's own, in the order in which a diagnosis tries them
CATALOGUE: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        friction.CoulombFriction,
        friction.ViscousFriction,
        friction.AsymmetricFriction,
        friction.StribeckFriction,
        friction.QuadraticDrag,
        changing_friction.LoadDependentFriction,
        changing_friction.PositionDependentFriction,
        changing_friction.TemperatureDependentFriction,
        hysteresis.PreslidingHysteresis,
        transmission.Armature,
        sensing.EncoderOffset,
        play.Backlash,
        transmission.JointElasticity,
        sensing.TorqueOffset,
        sensing.TorqueGain,
        delay.TimeDelay,
        sensing.TorqueCrosstalk,
        sensing.TorqueDrift,
        arm.SpringLoad,
        arm.JointCoupling,
        transmission.TorqueRipple,
        body.GravityDirection,
        body.Payload,
        body.PickedUpLoad,
        arm.ExternalContact,
    )
}
_KINDS = (BodyEffect, ArmEffect, TorqueEffect, MotionEffect, SensorEffect)


def effect_called(name: str) -> type[Effect]:
    """Return an effect by its identifier.

    Raises:
        ConfigError: There is none; the message lists the known ones.
        PlugInError: It is of another distribution and cannot be used, or one takes limo's name.
    """
    found = plug_in(EFFECTS, name, CATALOGUE)
    if name in CATALOGUE:
        return CATALOGUE[name]
    if found is None:
        raise ConfigError(f"effect {name!r} is unknown; known: {', '.join(known_names())}")
    return _checked(found)


def known_names() -> tuple[str, ...]:
    """Return all identifiers, in alphabetical order; those of plug-ins may yet prove unusable."""
    return tuple(sorted({*CATALOGUE, *names(EFFECTS)}))


def every_effect() -> tuple[type[Effect], ...]:
    """Return limo's own effects, and after them those of plug-ins that can be used, by name."""
    return tuple(_usable()[0].values())


def unusable() -> tuple[PlugInError, ...]:
    """Return why other plug-ins cannot be used."""
    return _usable()[1]


def known_as(name: str) -> type[Effect] | None:
    """Return an effect that can be used, by its identifier; None if there is none."""
    return _usable()[0].get(name)


def description_of(name: str) -> Description:
    """Return the description of an effect; an empty one of a name that is none."""
    effect = known_as(name)
    return Description() if effect is None else effect.description


def confusion_of(first: str, second: str) -> Confusion | None:
    """Return how two effects differ, whichever of them states it."""
    for one, other in ((first, second), (second, first)):
        for item in description_of(one).confusions:
            if item.other == other:
                return item
    return None


def identical_to(name: str) -> tuple[str, ...]:
    """Return the effects that are indistinguishable from one, whichever states it."""
    return tuple(
        other
        for effect in every_effect()
        for item in effect.description.confusions
        if item.identical and name in {effect.name, item.other}
        for other in (effect.name, item.other)
        if other != name
    )


def display_name(effect: str) -> str:
    """Return an effect's identifier in words."""
    return effect.replace("_", " ")


@cache
def _usable() -> tuple[dict[str, type[Effect]], tuple[PlugInError, ...]]:
    """Import all plug-ins; return what can be used, and what is wrong with the others."""
    usable, broken = dict(CATALOGUE), list[PlugInError]()
    for name in names(EFFECTS):
        try:
            found = plug_in(EFFECTS, name, CATALOGUE)
            if found is not None:
                usable[name] = _checked(found)
        except PlugInError as error:
            broken.append(error)
    return usable, tuple(broken)


@cache
def _checked(found: PlugIn) -> type[Effect]:
    """Import a plug-in and check that it is an effect that limo can use.

    Raises:
        PlugInError: It is not; the message says what is missing.
    """
    effect: Any = found.load()
    if not (isinstance(effect, type) and issubclass(effect, _KINDS)):
        kinds = ", ".join(kind.__name__ for kind in _KINDS)
        raise found.unusable(f"is no subclass of one of {kinds}")
    if isabstract(effect):
        lacking = ", ".join(sorted(effect.__abstractmethods__))
        raise found.unusable(f"{effect.__name__} does not define {lacking}")
    if getattr(effect, "name", None) != found.name:
        given = getattr(effect, "name", None)
        raise found.unusable(f"{effect.__name__} calls itself {given!r}, not {found.name!r}")
    return effect
