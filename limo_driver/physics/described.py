"""What a description states of its joints, as effects: where a nominal simulation starts."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics.effects.environment import SpringLoad
from limo_driver.physics.effects.friction import CoulombFriction, QuadraticDrag, ViscousFriction
from limo_driver.physics.effects.hysteresis import PreslidingHysteresis
from limo_driver.physics.effects.play import Backlash
from limo_driver.physics.effects.transmission import Armature, TorqueRipple

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.description import StatedBristles
    from limo_driver.physics.effect import Effect

# A description means a sign; smoothed over as little as recordings of slow arms resolve.
SIGN_WIDTH: Final = 0.005  # [rad/s]
REFLECTED: Final = ("friction", "damping", "armature")  # what is felt of a joint that follows


def described_effects(
    model: RobotModel, dynamics: Mapping[str, JointDynamics] | None = None
) -> tuple[Effect, ...]:
    """Return friction, damping, armature, springs, play and cogging that a description states.

    Args:
        model: The robot.
        dynamics: Of its joints, by name; those of its description if not given.
    """
    found: list[Effect] = []
    dynamics = model.description.dynamics if dynamics is None else dynamics
    added = reflected(model, dynamics)
    for joint, name in enumerate(model.joint_names, start=1):
        stated = dynamics.get(name, JointDynamics())
        more = {key: getattr(stated, key) + getattr(added[joint - 1], key) for key in REFLECTED}
        stated = replace(stated, **more)
        if stated.friction:
            found.append(CoulombFriction(joint=joint, tau_c=stated.friction, v_eps=SIGN_WIDTH))
        if stated.damping:
            found.append(ViscousFriction(joint=joint, f_v=stated.damping))
        if stated.armature:
            found.append(Armature(joint=joint, inertia=stated.armature))
        if stated.drag > 0:
            found.append(QuadraticDrag(joint=joint, coefficient=stated.drag))
        if stated.stiffness or stated.cubic:
            found.append(
                SpringLoad(
                    joint=joint, stiffness=stated.stiffness, rest=stated.rest, cubic=stated.cubic
                )
            )
        if stated.gap:
            found.append(Backlash(joint=joint, gap=stated.gap))
        found += _bristles(joint, stated.bristles)
        if stated.ripples:
            amplitude, cycles, phase = zip(*stated.ripples, strict=True)
            needed = tuple(angle + math.pi for angle in phase)  # to hold against it
            found.append(
                TorqueRipple(joint=joint, cycles_per_rev=cycles, amplitude=amplitude, phase=needed)
            )
    return tuple(found)


def reflected(
    model: RobotModel, dynamics: Mapping[str, JointDynamics]
) -> tuple[JointDynamics, ...]:
    """Return what joints that follow others add to those: friction, damping and armature.

    Args:
        model: The robot.
        dynamics: Of all joints, by name.
    """
    found = [JointDynamics()] * model.n
    for name, driver, ratio in zip(
        model.link_joints, model.linkage.driver, model.linkage.ratio.tolist(), strict=True
    ):
        if name not in model.description.followers or (own := dynamics.get(name)) is None:
            continue
        known = found[driver]
        found[driver] = replace(
            known,
            friction=known.friction + abs(ratio) * own.friction,
            damping=known.damping + ratio**2 * own.damping,
            armature=known.armature + ratio**2 * own.armature,
        )
    return tuple(found)


def _bristles(joint: int, stated: Iterable[StatedBristles]) -> list[Effect]:
    return [
        PreslidingHysteresis(
            joint=joint,
            law="lugre",
            sigma_0=item.stiffness,
            sigma_1=item.damping,
            tau_c=item.sliding,
            tau_s=max(item.breakaway - item.sliding, 0.0),
            v_s=item.speed,
        )
        for item in stated
    ]
