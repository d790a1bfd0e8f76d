"""What of the physics of each joint other simulators have a number for, and what is left."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.descriptions.description import JointDynamics
from limo_driver.exports.formats import MJCF, WITH_ARMATURE, WITH_FRICTION
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    BodyEffect,
    CoulombFriction,
    Effect,
    GravityDirection,
    Payload,
    PreslidingHysteresis,
    QuadraticDrag,
    SpringLoad,
    ViscousFriction,
)
from limo_driver.physics.described import SIGN_WIDTH

if TYPE_CHECKING:
    from limo_driver.physics import Simulation


_SHARP: Final = 1e-4  # [rad/s]


@dataclass(frozen=True)
class EffectSplit:
    """The effects of a simulation, as far as a target has numbers for them."""

    joints: tuple[JointDynamics, ...]  # of each joint
    payloads: tuple[Payload, ...]
    gravity: GravityDirection | None
    expressed: tuple[Effect, ...]  # exactly, or by what stands in for others
    left: tuple[Effect, ...]  # not at all
    stand_ins: tuple[tuple[Effect, Effect], ...]  # an effect, and what is expressed instead


def split(simulation: Simulation, target: str) -> EffectSplit:
    """Split the effects of a simulation into what a target expresses and what it does not.

    Args:
        simulation: What was found.
        target: One of `KINDS`.
    """
    joints = [JointDynamics()] * simulation.model.n
    expressed, left, payloads = list[Effect](), list[Effect](), list[Payload]()
    stand_ins: list[tuple[Effect, Effect]] = []
    gravity: GravityDirection | None = None
    for effect in simulation.effects:
        if isinstance(effect, Payload):
            payloads.append(effect)
        elif isinstance(effect, GravityDirection) and target == MJCF:
            gravity = effect
        elif isinstance(effect, GravityDirection):
            continue  # told as a whole, whichever way it came in
        elif isinstance(effect, BodyEffect) or not effect.joints:
            left.append(effect)
            continue
        else:
            j = effect.joints[0] - 1
            shown = stand_in(effect) or effect
            after = _with(joints[j], shown, target)
            if after is None:
                left.append(effect)
                continue
            if shown is not effect:
                stand_ins.append((effect, shown))
                effect = shown  # noqa: PLW2901  # what is expressed
            joints[j] = after
        expressed.append(effect)
    return EffectSplit(
        tuple(joints), tuple(payloads), gravity, tuple(expressed), tuple(left), tuple(stand_ins)
    )


def stand_in(effect: Effect) -> Effect | None:
    """Return what comes nearest to an effect among those that descriptions have numbers for.

    Hysteresis is dry friction once it slides; friction that differs by direction has a mean.
    """
    match effect:
        case PreslidingHysteresis(law="maxwell_slip"):
            height = float(np.dot(effect.stiffness, effect.width))
            return CoulombFriction(joint=effect.joint, tau_c=height, v_eps=SIGN_WIDTH)
        case AsymmetricFriction():
            mean = 0.5 * (effect.tau_plus + effect.tau_minus)
            return CoulombFriction(joint=effect.joint, tau_c=mean, v_eps=effect.v_eps)
        case ViscousFriction(f_v_plus=float(plus), f_v_minus=float(minus)):
            return ViscousFriction(joint=effect.joint, f_v=0.5 * (plus + minus))
        case _:
            return None


def sharp(effect: Effect) -> Effect:
    """Return a dry friction with the sign that other simulators have, and all else as it is.

    The width over which the sign is smoothed is none of the physics that was found.
    """
    return replace(effect, v_eps=_SHARP) if isinstance(effect, CoulombFriction) else effect


def _with(known: JointDynamics, effect: Effect, target: str) -> JointDynamics | None:
    """Return the numbers of a joint that has one effect more; None where there is none for it."""
    match effect:
        case CoulombFriction() if target in WITH_FRICTION:
            return replace(known, friction=known.friction + effect.tau_c)
        case ViscousFriction(f_v=float(slope)):
            return replace(known, damping=known.damping + slope)
        case Armature() if target in WITH_ARMATURE:
            return replace(known, armature=known.armature + effect.inertia)
        case QuadraticDrag() if target == MJCF:
            return replace(known, drag=known.drag + effect.coefficient)
        case SpringLoad() if target == MJCF and not (known.stiffness or known.cubic):
            return replace(known, stiffness=effect.stiffness, rest=effect.rest, cubic=effect.cubic)
        case _:
            return None
