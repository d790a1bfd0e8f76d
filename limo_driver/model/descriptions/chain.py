"""The chain of joints of a description that turn or slide, their limits and rotors."""

# pinocchio has no stubs and is found through an import hook; this file and `model` are the adapter.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import SITE, JointDynamics, RobotDescription
from limo_driver.model.dynamics import JointLinkage, linkage_of
from limo_driver.runtime.display import shortened
from limo_driver.types import FloatArray, JointLimits

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.model.descriptions.geometry import Inertial

JOINT = "/joint"  # added to the name of a joint for pinocchio, where a link has the same
_SLIDE = "JointModelP"  # begins the names of prismatic joints; planar ones are refused before
_FLANGES = frozenset({"flange", "tool0", "attachment_site"})
_KINDS = ("JointModelR", _SLIDE)
TURN = np.pi  # [rad] to either side, within which motion of a joint without ends is planned
# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
_ACCELERATION_PER_VELOCITY = 5.0  # [1/s], default where nothing is published
_SLOW, _SLOW_SLIDE = 1.0, 0.25  # [rad/s], [m/s], in formats that have no limits of velocity
_JERK_PER_VELOCITY = 50.0  # [1/s^2]
_TORQUE_RATE_PER_TORQUE = 10.0  # [1/s]
# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
_ROUNDING = 1e-9  # of a moment of inertia, which a rod has alike about two axes
_MOST_OF_OTHERS = 2.0  # times the sum of the others, that a principal moment is still a rounding


@dataclass(frozen=True)
class Chain:
    """The joints of an arm that turn or slide; all others are locked where they are neutral."""

    model: pin.Model  # of n joints; those that follow others are pinocchio's mimics
    tree: pin.Model  # of m links, each with a joint of its own
    linkage: JointLinkage
    locked: tuple[str, ...]  # names of joints
    turning: tuple[str, ...]  # names of the revolute joints without ends
    sliding: tuple[bool, ...]  # (n,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints that move on their own, (n,), as the description has them."""
        return tuple(self.link_joints[link] for link in self.linkage.own)

    @property
    def link_joints(self) -> tuple[str, ...]:
        """Names of the own joint of each link, (m,)."""
        return _names(self.tree)


def _names(model: pin.Model) -> tuple[str, ...]:
    """Return the names of the joints of a model, as the description has them."""
    return tuple(name.removesuffix(JOINT) for name in model.names)[1:]


def read_chain(description: RobotDescription) -> Chain:
    """Read the joints of an arm.

    A continuous joint becomes a revolute one, whose position counts the turns: pinocchio would
    describe it by the point on a circle, which a recording does not.

    Args:
        description: As read.

    Raises:
        ConfigError: It is no URDF, or has no joint that turns or slides.
    """
    path = description.path
    text, turning = _with_ends(description)
    try:
        full = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError, IndexError) as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"cannot be read as a URDF: {reason}", path=path) from None
    locked = [
        index
        for index in range(1, full.njoints)
        if not full.joints[index].shortname().startswith(_KINDS)
    ]
    names = tuple(full.names[index].removesuffix(JOINT) for index in locked)
    if len(locked) == full.njoints - 1:
        held = shortened(list(description.locked))
        why = f"; {held} are locked, and none is left to move" if description.locked else ""
        raise ConfigError(f"has no joint that turns or slides{why}", path=path)
    tree = pin.buildReducedModel(full, locked, pin.neutral(full))
    followers = dict(description.followers)
    tree = _with_leaders_first(tree, {name: item.leader for name, item in followers.items()}, path)
    linkage = linkage_of(_names(tree), followers)
    model = tree
    for link in np.flatnonzero(linkage.own[linkage.driver] != np.arange(linkage.links)).tolist():
        leader = int(linkage.own[linkage.driver[link]])
        ratio, offset = float(linkage.ratio[link]), float(linkage.offset[link])
        model = pin.transformJointIntoMimic(model, leader + 1, link + 1, ratio, offset)
    joints = list(tree.joints)[1:]
    sliding = tuple(joints[link].shortname().startswith(_SLIDE) for link in linkage.own)
    return Chain(model, tree, linkage, names, turning, sliding)


def _with_leaders_first(tree: pin.Model, leaders: dict[str, str], path: Path) -> pin.Model:
    """Return a tree whose joints come after those that they follow.

    Args:
        tree: Of links, each with a joint of its own.
        leaders: Of joints that follow others, by name.
        path: Of the description.

    Raises:
        ConfigError: A joint follows one that it carries.
    """
    names, parents = _names(tree), list(tree.parents)
    waiting, order = list(range(1, tree.njoints)), [0]

    def led(joint: int) -> list[int]:
        leader = leaders.get(names[joint - 1])
        return [] if leader is None else [names.index(leader) + 1]

    while waiting:
        needs = {joint: [parents[joint], *led(joint)] for joint in waiting}
        ready = [joint for joint in waiting if set(needs[joint]) <= set(order)]
        if not ready:
            held = next(names[joint - 1] for joint in waiting if names[joint - 1] in leaders)
            raise ConfigError(
                f"joint {held} follows {leaders[held]}, which it carries: let that one follow it",
                path=path,
            )
        order.append(ready[0])
        waiting.remove(ready[0])
    return tree if order == list(range(tree.njoints)) else _ordered(tree, order)


def _ordered(tree: pin.Model, order: list[int]) -> pin.Model:
    """Return a tree with its joints in another order, `order[new] = old`."""
    new, place = pin.Model(), {old: at for at, old in enumerate(order)}
    new.name, new.gravity = tree.name, tree.gravity
    for old in order[1:]:
        at = int(tree.idx_vs[old])
        one = slice(at, at + 1)
        new.addJoint(
            place[tree.parents[old]],
            tree.joints[old],
            tree.jointPlacements[old],
            tree.names[old],
            tree.lowerEffortLimit[one],
            tree.upperEffortLimit[one],
            tree.lowerVelocityLimit[one],
            tree.upperVelocityLimit[one],
            tree.lowerPositionLimit[one],
            tree.upperPositionLimit[one],
            tree.lowerDryFrictionLimit[one],
            tree.upperDryFrictionLimit[one],
            tree.damping[one],
        )
        new.appendBodyToJoint(place[old], tree.inertias[old], pin.SE3.Identity())
    for frame in list(tree.frames)[1:]:
        moved = pin.Frame(frame.name, place[frame.parentJoint], 0, frame.placement, frame.type)
        new.addFrame(moved, False)
    return new


def link_of_joint(model: pin.Model, joint: int) -> str:
    """Return the link that a joint moves: the body frame that coincides with it."""
    bodies = [
        frame
        for frame in model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]
    return str(bodies[0].name)


def last_frame(model: pin.Model, joint: int) -> int:
    """Return the frame farthest along the fixed links of the last joint: the flange."""
    frames = [
        index
        for index, frame in enumerate(model.frames)
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    ]
    named = [i for i in frames if model.frames[i].name.removeprefix(SITE) in _FLANGES]
    return (named or frames)[0 if named else -1]


def frames_of_joint(model: pin.Model, joint: int) -> dict[str, FloatArray]:
    """Return the frames that move rigidly with a joint, (4, 4) each in that of its link, by name.

    Of a site of an MJCF file, it is the name there.
    """
    return {
        frame.name.removeprefix(SITE): np.array(frame.placement.homogeneous)
        for frame in model.frames
        if frame.parentJoint == joint and frame.type == pin.FrameType.BODY
    }


def frames_alone(tree: pin.Model, description: RobotDescription) -> frozenset[str]:
    """Return links that are no more than a frame between two axes, and need no mass.

    They have no shape, nor has what is fixed to them, and carry a link that has a mass.

    Args:
        tree: Of links, each with a joint of its own.
        description: As read.
    """
    shaped = {
        str(link.get("name"))
        for link in description.root.findall("link")
        if link.find("visual") is not None or link.find("collision") is not None
    }
    found = set[str]()
    for joint in range(1, tree.njoints):
        carried = [k for k in tree.subtrees[joint] if k != joint]
        if any(tree.inertias[k].mass > 0 for k in carried) and shaped.isdisjoint(
            frames_of_joint(tree, joint)
        ):
            found.add(link_of_joint(tree, joint))
    return frozenset(found)


def _with_ends(description: RobotDescription) -> tuple[str, tuple[str, ...]]:
    """Return the text with an end to either side of each continuous joint, and their names.

    Links and joints may share names in a file; in pinocchio, both are frames.
    """
    root = description.without("visual", "collision", "material")
    links = {link.get("name") for link in root.findall("link")}
    joints = [joint for joint in root.findall("joint") if joint.get("type") == "continuous"]
    for joint in joints:
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
        limit.set("lower", repr(-TURN))
        limit.set("upper", repr(TURN))
    turning = tuple(str(joint.get("name")) for joint in joints)
    for joint in root.findall("joint"):
        if joint.get("name") in links:
            joint.set("name", f"{joint.get('name')}{JOINT}")
    return ET.tostring(root, encoding="unicode"), turning


def unstated_limits(
    model: pin.Model, names: Sequence[str], sliding: Sequence[bool], *, assumed: bool
) -> tuple[str, ...]:
    """Say which limits the description leaves out, and what stands for them."""
    notes: list[str] = []
    slow = f"{_SLOW:g} rad/s is taken" + (
        f", {_SLOW_SLIDE:g} m/s of slides" if any(sliding) else ""
    )
    for values, what, instead in (
        (model.upperVelocityLimit, "velocity", slow),
        (model.upperEffortLimit, "effort", "none is kept"),
    ):
        lacking = [name for name, value in zip(names, np.array(values), strict=True) if value <= 0]
        if lacking:
            stands = instead if assumed else "without one, the arm cannot be planned or run"
            who = f"joints {shortened(lacking)} state"
            if len(lacking) == 1:
                who = f"joint {lacking[0]} states"
            elif len(lacking) == len(names):
                who = f"all {len(names)} joints state"
            notes.append(f"{who} no {what} limit; {stands}")
    return tuple(notes)


def joint_limits(
    chain: Chain, jerk: FloatArray | None, path: Path, *, assumed: bool
) -> JointLimits:
    """Return the limits of the joints, within which those that follow them are in theirs.

    A 0 stays unless values are assumed for what is not stated. MJCF has no limits of velocity, so
    that nothing would move. A URDF that states a 0 leaves out what it should state: no speed of a
    real arm is made up for it.

    Raises:
        ConfigError: A joint cannot move without one that follows it leaving its range.
    """
    own = chain.linkage.own
    velocity = np.array(chain.tree.upperVelocityLimit)[own]
    torque = np.array(chain.tree.upperEffortLimit)[own]
    lower = np.array(chain.tree.lowerPositionLimit)[own]
    upper = np.array(chain.tree.upperPositionLimit)[own]
    if assumed:
        velocity = np.where(velocity > 0, velocity, np.where(chain.sliding, _SLOW_SLIDE, _SLOW))
        torque = np.where(torque > 0, torque, np.inf)
    # Narrow limits (n,) to those at which followers reach theirs
    tree, linkage = chain.tree, chain.linkage
    for link in np.flatnonzero(linkage.own[linkage.driver] != np.arange(linkage.links)).tolist():
        joint, ratio = int(linkage.driver[link]), float(linkage.ratio[link])
        if chain.link_joints[link] not in chain.turning:
            ends = np.array([tree.lowerPositionLimit[link], tree.upperPositionLimit[link]])
            low, high = sorted(((ends - linkage.offset[link]) / ratio).tolist())
            lower[joint], upper[joint] = max(lower[joint], low), min(upper[joint], high)
        if (fastest := float(tree.upperVelocityLimit[link])) > 0:
            velocity[joint] = min(velocity[joint], fastest / abs(ratio))
        if lower[joint] > upper[joint]:
            raise ConfigError(
                f"joint {chain.link_joints[link]} follows {chain.names[joint]}, and there is no "
                "position of that at which both are within their limits",
                path=path,
            )
    planned = _JERK_PER_VELOCITY * velocity
    if jerk is not None:
        planned = np.where(np.isfinite(jerk), jerk, planned)
    return JointLimits(
        position_min=lower,
        position_max=upper,
        velocity=velocity,
        acceleration=_ACCELERATION_PER_VELOCITY * velocity,
        jerk=planned,
        torque=torque,
        torque_rate=_TORQUE_RATE_PER_TORQUE * torque,
    )


def is_nearly_possible(body: Inertial) -> bool:
    """Say whether principal moments are those of a body, but for rounding."""
    smallest, middle, largest = np.linalg.eigvalsh(body.tensor()).tolist()
    return smallest > 0.0 and largest <= _MOST_OF_OTHERS * (smallest + middle)


def with_drives_apart(
    description: RobotDescription,
    tree: pin.Model,
    inertials: dict[str, Inertial],
    joints: Sequence[str],
) -> tuple[dict[str, Inertial], tuple[str, ...]]:
    """Take the inertia of drives out of links that no body has, and state it for their joints.

    Behind a gear, a rotor counts with the square of the ratio, and about the axis of its joint
    alone. Some makers add that to the link: more about this axis than about both others together,
    which the mass of no link brings. Taken for a body it would be felt about those, too.

    Args:
        description: Of the arm; gets the armatures.
        tree: Of its links, each with a joint of its own.
        inertials: Of those links, by name.
        joints: That move them, by link.

    Returns:
        Those links that change, and what to say of them.
    """
    changed: dict[str, Inertial] = {}
    notes: list[str] = []
    for index, ((link, body), joint) in enumerate(zip(inertials.items(), joints, strict=True)):
        if is_nearly_possible(body) or body.mass <= 0:
            continue
        axis = np.array(tree.joints[index + 1].createData().S).ravel()[3:]
        tensor = body.tensor()
        about = float(axis @ tensor @ axis)
        surplus = 2.0 * about - float(np.trace(tensor))
        if surplus <= _ROUNDING * about:
            continue
        left = tensor - surplus * np.outer(axis, axis)
        xx, xy, xz, yy, yz, zz = left[np.triu_indices(3)].tolist()
        found = replace(body, inertia=(xx, xy, xz, yy, yz, zz))
        if not is_nearly_possible(found):
            continue
        stated = description.dynamics.get(joint, JointDynamics())
        description.dynamics[joint] = replace(stated, armature=stated.armature + surplus)
        changed[link] = found
        notes.append(
            f"link {link} has {about:.3g} kg m² about the axis of joint {joint}, more than its "
            f"mass brings: {surplus:.3g} kg m² are taken as the inertia of the drive (armature)"
        )
    return changed, tuple(notes)
