"""What of the physics of each joint other simulators have a number for, and what is left."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from limo_driver.exports.xml_edits import MJCF, WITH_ARMATURE, WITH_FRICTION
from limo_driver.model.descriptions.description import (
    JointDynamics,
    StatedBristles,
    StatedRipple,
    StatedSlip,
)
from limo_driver.physics import (
    Armature,
    AsymmetricFriction,
    Backlash,
    BodyEffect,
    CoulombFriction,
    Effect,
    GravityDirection,
    Payload,
    PositionDependentFriction,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    SpringLoad,
    TorqueRipple,
    ViscousFriction,
)
from limo_driver.physics.described import SIGN_WIDTH
from limo_driver.physics.effect import TorqueEffect
from limo_driver.physics.effects.friction import VelocityFriction
from limo_driver.physics.effects.hysteresis import LAWS, MAXWELL_SLIP

_SHARP: Final = 1e-4  # [rad/s]
_STIFFER: Final = 1.2  # than height over mean width: least torque left of four elements


@dataclass(frozen=True)
class EffectSplit:
    """The effects of a simulation, as far as a target has numbers for them."""

    joints: tuple[JointDynamics, ...]  # of each joint
    payloads: tuple[Payload, ...]
    gravity: GravityDirection | None
    expressed: tuple[Effect, ...]  # exactly, or by what stands in for others
    left: tuple[Effect, ...]  # not at all
    stand_ins: tuple[tuple[Effect, Effect], ...]  # an effect, and what is expressed instead


def split(
    simulation: Simulation, target: str, *, with_play: bool = False, with_slips: bool = False
) -> EffectSplit:
    """Split the effects of a simulation into what a target expresses and what it does not.

    Args:
        simulation: What was found.
        target: One of `KINDS`.
        with_play: Whether play may be written, as a hinge between drive and link: of joints whose
            drive has an inertia.
        with_slips: Whether slip elements may be written, as plastic springs.
    """
    driven = {x.joint for x in simulation.effects if isinstance(x, Armature) and x.inertia > 0}
    with_play = with_play and target == MJCF
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
        elif isinstance(effect, Backlash):
            j = effect.joint - 1
            falls = effect.displaces and with_play and effect.joint in driven
            if not falls or simulation.model.sliding[j]:
                left.append(effect)
                continue
            gap, damping = joints[j].gap + effect.gap, effect.damping or 0.0
            joints[j] = replace(joints[j], gap=gap, gap_damping=damping)
        else:
            j = effect.joints[0] - 1
            is_slip = with_slips and target == MJCF and _slips(effect)
            shown = effect if is_slip else stand_in(effect, target) or everywhere(effect)
            after = _with(joints[j], shown, target) or _with_memory(joints[j], shown, target)
            if after is None:
                left.append(effect)
                continue
            if shown is not effect:
                if target != MJCF or not _is_exact(effect):
                    stand_ins.append((effect, shown))
                effect = shown  # noqa: PLW2901  # what is expressed
            joints[j] = after
        expressed.append(effect)
    return EffectSplit(
        tuple(joints), tuple(payloads), gravity, tuple(expressed), tuple(left), tuple(stand_ins)
    )


def everywhere(effect: Effect) -> Effect:
    """Return an effect whose equation holds beyond its domain, too, which no target has."""
    if not isinstance(effect, TorqueEffect) or effect.domain is None:
        return effect
    is_same = isinstance(effect, VelocityFriction) and effect.is_law
    return effect if is_same else replace(effect, domain=None)


def stand_in(effect: Effect, target: str) -> Effect | None:
    """Return what comes nearest to an effect among those that a target has numbers for.

    Hysteresis is dry friction once it slides, and MuJoCo has bristles for what goes before;
    friction that differs by direction or position has a mean.

    Args:
        effect: That was found.
        target: One of `KINDS`.
    """
    match effect:
        case PreslidingHysteresis() if target == MJCF:
            return as_bristles(effect)
        case PreslidingHysteresis() if (height := _height(effect)) is not None:
            return CoulombFriction(joint=effect.joint, tau_c=height, v_eps=SIGN_WIDTH)
        case AsymmetricFriction():
            mean = 0.5 * (effect.tau_plus + effect.tau_minus)
            return CoulombFriction(joint=effect.joint, tau_c=mean, v_eps=effect.v_eps)
        case PositionDependentFriction() if effect.mean > 0:
            return CoulombFriction(joint=effect.joint, tau_c=effect.mean, v_eps=effect.v_eps)
        case ViscousFriction(f_v_plus=float(plus), f_v_minus=float(minus)):
            return ViscousFriction(joint=effect.joint, f_v=0.5 * (plus + minus))
        case _:
            return None


def _slips(effect: Effect) -> bool:
    return isinstance(effect, PreslidingHysteresis) and effect.law == MAXWELL_SLIP


def as_bristles(effect: PreslidingHysteresis) -> PreslidingHysteresis | None:
    """Return hysteresis by the law of LuGre; None if it has that law, or none comes near to it.

    Slip elements are one bristle of their height, as stiff as makes it build up over their mean
    width, which leaves 3 % of their torque where dry friction leaves 30 %.

    Args:
        effect: By any law.
    """
    height = _height(effect)
    if effect.law == "lugre" or height is None:
        return None
    stiffness = effect.sigma_0
    if effect.law == MAXWELL_SLIP:
        mean_width = float(np.dot(effect.stiffness, np.square(effect.width))) / height
        stiffness = _STIFFER * height / mean_width
    return PreslidingHysteresis(joint=effect.joint, law="lugre", sigma_0=stiffness, tau_c=height)


def _height(effect: PreslidingHysteresis) -> float | None:
    """Return the friction once it slides [N m]; None where that depends on the position."""
    if effect.law == MAXWELL_SLIP:
        return float(np.dot(effect.stiffness, effect.width))
    return effect.tau_c


def _is_exact(effect: Effect) -> bool:
    """Say whether hysteresis is the same by the law of LuGre."""
    match effect:
        case PreslidingHysteresis(law="dahl"):
            return (effect.exponent or 1.0) == 1.0
        case PreslidingHysteresis(law="bouc_wen"):
            return effect.beta_ratio == 1.0 and (effect.exponent or 1.0) == 1.0
        case _:
            return False


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


def _with_memory(known: JointDynamics, effect: Effect, target: str) -> JointDynamics | None:
    """Return the numbers of a joint whose friction has memory, or that cogs, likewise."""
    if target != MJCF:
        return None
    match effect:
        case TorqueRipple():
            lines = zip(effect.amplitude, effect.cycles_per_rev, effect.phase, strict=True)
            added = [StatedRipple(A, N, _against(phi)) for A, N, phi in lines if A]
            return replace(known, ripples=(*known.ripples, *added))
        case PreslidingHysteresis(law="maxwell_slip"):
            pairs = zip(effect.stiffness, effect.width, strict=True)
            return replace(known, slips=(*known.slips, *(StatedSlip(*pair) for pair in pairs)))
        case PreslidingHysteresis(law="lugre", sigma_0=float(stiffness), tau_c=float(sliding)):
            breakaway = sliding + (effect.tau_s or 0.0)
            speed = effect.v_s or LAWS["lugre"].optional["v_s"]
            damping = effect.sigma_1 or 0.0
            own = StatedBristles(stiffness, damping, sliding, breakaway, speed)
            return replace(known, bristles=(*known.bristles, own))
        case _:
            return None


def _against(phase: float) -> float:
    """Return the phase of a torque on a joint that another one holds against."""
    return math.remainder(phase + math.pi, math.tau)
