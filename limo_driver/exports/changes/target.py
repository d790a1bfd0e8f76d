"""The file that a simulation is written into: found, and checked to be of the same arm."""

# MuJoCo ships no stubs.
# pyright: reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.changes import bodies
from limo_driver.exports.changes.joints import EffectSplit, split
from limo_driver.exports.changes.origin import FileOrigin
from limo_driver.exports.xml_edits import MJCF, USD, XmlText, edited_format
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics import (
    Armature,
    Backlash,
    CoulombFriction,
    Effect,
    PreslidingHysteresis,
    ViscousFriction,
    display_name,
)
from limo_driver.physics.described import REFLECTED, described_effects, reflected
from limo_driver.physics.effect import Friction
from limo_driver.runtime.installed_mujoco import OLDEST, PLASTIC, mujoco

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from limo_driver.model.descriptions.geometry import Inertial
    from limo_driver.physics import Payload, Simulation

_POSES: Final = 5
_APART: Final = 1e-4  # [m], [rad], by which joints may stand elsewhere: files round
_ROUNDING: Final = 1e-9  # relative


@dataclass(frozen=True)
class Target:
    """A file, and what of it has to change."""

    model: RobotModel  # as the file has it
    simulation: Simulation  # with what the file states and nothing was said of
    split: EffectSplit
    inertials: Mapping[str, Inertial]  # new ones, by body of the file, in its frame
    last: str  # body that payloads are fixed to
    kept: tuple[str, ...]  # lines: what of the file's own joints stays, as nothing was said of it
    users: Mapping[str, JointDynamics]  # what the user's file states, without limo's own
    origin: FileOrigin  # what an earlier export wrote
    dropped: tuple[str, ...] = ()  # lines: what of that goes
    loads: Mapping[str, Payload] = field(default_factory=dict)  # by name of the body in the file
    replaced: tuple[str, ...] = ()  # bodies of the file that loads stand for now, or that go
    added: Mapping[str, bodies.AddedBody] = field(default_factory=dict)  # bodies that exports added

    def joints(self) -> list[tuple[str, JointDynamics, JointDynamics]]:
        """Return of each joint its name, what the file states, and what it shall have."""
        known = self.model.description.dynamics
        pairs = zip(self.model.joint_names, self.split.joints, strict=True)
        return [(name, known.get(name, JointDynamics()), wanted) for name, wanted in pairs]

    def needed_mujoco(self) -> str:
        """Return the oldest MuJoCo that has all that joints shall have; empty if any that does."""
        if any(wanted.slips for wanted in self.split.joints):
            return f"{PLASTIC}.0"
        has_motors = any(wanted.bristles or wanted.ripples for wanted in self.split.joints)
        return ".".join(map(str, OLDEST)) if has_motors else ""

    def added_by_now(self, written: Mapping[str, Inertial]) -> dict[str, bodies.AddedBody]:
        """Return the bodies that exports have added once these loads are written as these."""
        kept = {name: body for name, body in self.added.items() if name not in self.replaced}
        return kept | {name: bodies.AddedBody(self.last, body) for name, body in written.items()}


def target_of(simulation: Simulation, into: Path, kind: str, release: int) -> Target:
    """Compare a file with a simulation.

    Args:
        simulation: What was found.
        into: The file.
        kind: One of `KINDS`.
        release: Of MuJoCo, that shall read it: 4 or more has plastic springs.

    Raises:
        ConfigError: It is of another kind, or of another arm.
    """
    own = simulation.model
    is_own = into.exists() and own.urdf.exists() and into.samefile(own.urdf)
    model = RobotModel(into, joints=own.chosen if is_own else own.joint_names)
    if model.description.kind.lower() != (wanted := edited_format(kind)):
        raise ConfigError(
            f"is {model.description.kind}, expected {wanted.upper()} to export to {kind}", path=into
        )
    _check_same(own, model, into)
    parts = bodies.parts_of(model)
    changes: dict[str, Inertial] = {}
    rescaled: list[str] = []
    text = None if kind == USD else XmlText(into)
    added = {} if text is None else bodies.still_there(bodies.added_bodies(text), parts.values())
    replaced = bodies.replaced_bodies(
        list(parts.values())[-1], added, list(own.inertials.values())[-1]
    )
    for its_parts, wanted in zip(parts.values(), own.inertials.values(), strict=True):
        left = tuple(part for part in its_parts if part.name not in replaced)
        found = bodies.shared(left, wanted)
        rescaled += bodies.rescaled_lines(left, found, wanted)
        changes |= found
    dynamics = model.description.dynamics
    origin = FileOrigin.of_layer(into) if text is None else FileOrigin.of(text)
    users = {name: origin.users(name, own) for name, own in dynamics.items()}
    kept = kept_effects(simulation, model, users)
    dropped = dropped_lines(simulation, described_effects(model), described_effects(model, users))
    whole = replace(simulation, effects=(*simulation.effects, *kept))
    lines = kept_lines(kept, model.joint_names)
    with_play = kind == MJCF and (_can_have_play(into) or bool(model.description.plays))
    slips = any(own.slips for own in dynamics.values())
    with_slips = kind == MJCF and release >= PLASTIC and (slips or _can_slip(into))
    parts_split = split(whole, kind, with_play=with_play, with_slips=with_slips)
    loads = bodies.placed(parts_split.payloads, replaced, _names(model))
    joints, more = without(parts_split.joints, reflected(model, dynamics), model)
    return Target(
        model,
        whole,
        replace(parts_split, joints=joints),
        changes,
        list(parts)[-1],
        (*lines, *more),
        users,
        origin,
        (*dropped, *bodies.gone_lines(replaced, loads, added), *rescaled),
        loads,
        replaced,
        added,
    )


def _names(model: RobotModel) -> set[str]:
    """Return the names in a file that an added body may not have."""
    if model.description.kind == "MJCF":
        return {body.name for body in mujoco.MjSpec.from_file(str(model.urdf)).bodies}
    return {str(element.get("name")) for element in model.description.root}


def _can_have_play(into: Path) -> bool:
    """Say whether joints can be added to an MJCF file: keyframes list positions by number."""
    return not mujoco.MjSpec.from_file(str(into)).keys


def _can_slip(into: Path) -> bool:
    """Say whether plastic springs slip as they should: RK4 and DISCRETE bend them within a step."""
    kinds = mujoco.mjtIntegrator
    exact = (kinds.mjINT_EULER, kinds.mjINT_IMPLICIT, kinds.mjINT_IMPLICITFAST)
    return mujoco.MjSpec.from_file(str(into)).option.integrator in exact


def _check_same(own: RobotModel, model: RobotModel, into: Path) -> None:
    for has, wanted in (
        (model.joint_names, own.joint_names),
        (model.link_joints, own.link_joints),  # with those that follow
    ):
        if has != wanted:
            raise ConfigError(
                f"has the joints {', '.join(has)}, but the simulation is of {', '.join(wanted)}",
                path=into,
            )
    random = np.random.default_rng(0)
    for _ in range(_POSES):
        q = random.uniform(-1.0, 1.0, own.n)
        apart = np.abs(own.joint_poses(q) - model.joint_poses(q)).max(axis=(1, 2))
        if (apart > _APART).any():
            j = int((apart > _APART).argmax())
            raise ConfigError(
                f"joint {own.link_joints[j]} stands elsewhere than in {own.name}: they are not the "
                "same arm, or have other bases",
                path=into,
            )


def without(
    found: Sequence[JointDynamics], added: Sequence[JointDynamics], model: RobotModel
) -> tuple[tuple[JointDynamics, ...], tuple[str, ...]]:
    """Return what is left of each joint beside its followers, and a line where that is below 0.

    Args:
        found: Of each joint with all that follows it.
        added: What those that follow it add to it, as the file has them.
        model: The robot as the file has it.
    """
    left, lines = list[JointDynamics](), list[str]()
    for name, whole, more in zip(model.joint_names, found, added, strict=True):
        values: dict[str, float] = {}
        for key in REFLECTED:
            total, other = getattr(whole, key), getattr(more, key)
            if other:
                rest = total - other
                values[key] = rest if abs(rest) > _ROUNDING * total else 0.0
            if values.get(key, 0.0) < 0.0:
                values[key] = 0.0
                lines.append(
                    f"joint {name}: the file's own {key} of what follows it, {other:.3g} as it is "
                    f"felt there, stays; {total:.3g} was found of both together"
                )
        left.append(replace(whole, **values))
    return tuple(left), tuple(lines)


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
        *others, last = map(_describe, own)
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
        f"joint {names[effect.joints[0] - 1]}: {_describe(effect)}, which an earlier export wrote; "
        "the simulation has it no longer"
        for effect in stated
        if effect not in users and (effect.joints[0], _kind(effect)) not in said
    )


def _kind(effect: Effect) -> type[Effect]:
    return Friction if isinstance(effect, Friction | PreslidingHysteresis) else type(effect)


def _describe(effect: Effect) -> str:
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
            return display_name(effect.name)
