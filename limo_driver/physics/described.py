"""Effects of a description, and those of a kind as one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Final, TypeGuard

import numpy as np

from limo_driver.model import RobotModel
from limo_driver.model.descriptions.description import JointDynamics, StatedBristles
from limo_driver.physics.effect import MOST_SLOPE, BodyEffect, Effect, SensorEffect, State
from limo_driver.physics.effects.arm import SpringLoad
from limo_driver.physics.effects.friction import (
    CoulombFriction,
    Frictions,
    QuadraticDrag,
    VelocityFriction,
    ViscousFriction,
)
from limo_driver.physics.effects.hysteresis import MAXWELL_SLIP, MaxwellSlips, PreslidingHysteresis
from limo_driver.physics.effects.play import Backlash
from limo_driver.physics.effects.sensing import TorqueOffset
from limo_driver.physics.effects.transmission import (
    Armature,
    JointElasticity,
    TorqueRipple,
    wind_up,
)
from limo_driver.types import FloatArray, Motion

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
            # more than any drive overcomes, as files lock joints by it, is no more than the most
            found.append(ViscousFriction(joint=joint, f_v=min(stated.damping, MOST_SLOPE)))
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
            found.append(Backlash(joint=joint, gap=stated.gap, damping=stated.gap_damping or None))
        found += _bristles(joint, stated.bristles)
        if stated.slips:
            stiffness, width = zip(*stated.slips, strict=True)
            found.append(PreslidingHysteresis(joint=joint, stiffness=stiffness, width=width))
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


def _is_plain(effect: Effect) -> TypeGuard[VelocityFriction]:
    """Say whether compiled code evaluates an effect, with others like it."""
    return isinstance(effect, VelocityFriction) and effect.is_law


class EffectGroups:
    """The effects of a simulation of n joints by how they are evaluated.

    Args:
        effects: In the order of their memories.
        n: Number of joints.
    """

    def __init__(self, effects: Sequence[Effect], n: int) -> None:
        numbered = tuple(enumerate(effects))
        slipping = [
            (i, item)
            for i, item in numbered
            if isinstance(item, PreslidingHysteresis) and item.law == MAXWELL_SLIP
        ]
        elastic = [e for e in effects if isinstance(e, JointElasticity) and e.damping is None]
        self.sensing = tuple((i, item) for i, item in numbered if isinstance(item, SensorEffect))
        self._frictions = Frictions.of([e for e in effects if _is_plain(e)])
        self._slips = MaxwellSlips([item for _, item in slipping])
        self._slip_places = tuple(i for i, _ in slipping)
        self._compliances = np.zeros((2, n))  # [rad/(N m)], and cubic [rad/(N m)³]
        for item in elastic:
            self._compliances[:, item.joint - 1] += 1.0 / item.stiffness, item.cubic
        self.is_elastic = bool(elastic)
        self._offsets = np.zeros(n)  # [N m]
        for item in effects:
            if isinstance(item, TorqueOffset):
                self._offsets[item.joint - 1] += item.offset
        together = (BodyEffect, SensorEffect, TorqueOffset)
        self.single = tuple(
            (i, item)
            for i, item in numbered
            if not isinstance(item, together)
            and not (_is_plain(item) or item in elastic)
            and i not in self._slip_places
        )

    def write_torques(self, torque: FloatArray, motion: Motion, memories: list[State]) -> None:
        """Write what acts together to `torque` (T, n) [N m], its new memories to the list."""
        torque[:] = self._offsets
        self._frictions.add(torque, motion.velocity)
        if places := self._slip_places:
            after = self._slips.add(torque, motion, [memories[i] for i in places])
            for i, memory in zip(places, after, strict=True):
                memories[i] = memory

    def wind_up(self, load: FloatArray) -> FloatArray:
        """Return how far the elastic joints wind up under a load (T, n) [N m], (T, n) [rad]."""
        return wind_up(load, self._compliances[0], self._compliances[1])
