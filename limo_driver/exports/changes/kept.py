"""What a file states of its joints and a simulation says nothing of: it stays as it is."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from limo_driver.physics import (
    Armature,
    Backlash,
    CoulombFriction,
    Effect,
    PreslidingHysteresis,
    ViscousFriction,
    spoken,
)
from limo_driver.physics.described import described_effects
from limo_driver.physics.effect import Friction

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from limo_driver.model import RobotModel
    from limo_driver.model.descriptions.description import JointDynamics
    from limo_driver.physics import Simulation


def kept_effects(
    simulation: Simulation, model: RobotModel, dynamics: Mapping[str, JointDynamics]
) -> tuple[Effect, ...]:
    """Return what a file states of joints of which a simulation has no effect of that kind.

    All friction of a joint is one kind: what was found of it replaces what the file states,
    whichever law either has. Who means that a joint has none of a kind gives it the effect with 0.

    Args:
        simulation: What was found.
        model: The robot as the file has it, with the same joints.
        dynamics: What of it the user's file states, without what an earlier export wrote.
    """
    said = {(joint, _kind(effect)) for effect in simulation.effects for joint in effect.joints}
    return tuple(
        effect
        for effect in described_effects(model, dynamics)
        if (effect.joints[0], _kind(effect)) not in said
    )


def kept_lines(effects: Iterable[Effect], joint_names: Sequence[str]) -> tuple[str, ...]:
    """Say what stays of each joint, in a line each.

    Args:
        effects: Of `kept_effects`, in order of joints.
        joint_names: Of the robot.
    """
    lines = list[str]()
    for joint, own in groupby(effects, lambda effect: effect.joints[0]):
        *others, last = map(_said, own)
        both = f"{', '.join(others)} and {last}" if others else last
        lines.append(
            f"joint {joint_names[joint - 1]}: the file's own {both} "
            f"{'stay' if others else 'stays'}; the simulation says nothing of "
            f"{'them' if others else 'it'}"
        )
    return tuple(lines)


def dropped_lines(
    simulation: Simulation, stated: Sequence[Effect], users: Sequence[Effect]
) -> tuple[str, ...]:
    """Say what an earlier export wrote that goes, as the simulation has it no longer.

    Args:
        simulation: What was found.
        stated: Effects of the file as it is.
        users: Effects of what the user's file states.
    """
    said = {(joint, _kind(effect)) for effect in simulation.effects for joint in effect.joints}
    names = simulation.model.joint_names
    return tuple(
        f"joint {names[effect.joints[0] - 1]}: {_said(effect)}, which an earlier export wrote; the "
        "simulation has it no longer"
        for effect in stated
        if effect not in users and (effect.joints[0], _kind(effect)) not in said
    )


def _kind(effect: Effect) -> type[Effect]:
    return Friction if isinstance(effect, Friction | PreslidingHysteresis) else type(effect)


def _said(effect: Effect) -> str:
    match effect:
        case CoulombFriction():
            return f"dry friction {effect.tau_c:g} N m"
        case ViscousFriction(f_v=float(slope)):
            return f"damping {slope:g} N m s/rad"
        case Armature():
            return f"armature {effect.inertia:g} kg m²"
        case Backlash():
            return f"play {effect.gap:g} rad"
        case _:
            return spoken(effect.name)
