"""The chain of joints of a description that turn or slide, as pinocchio has it."""

# pinocchio has no stubs and is found through an import hook; this file and `model` are the adapter.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from limo_driver.descriptions.description import RobotDescription

JOINT = "/joint"  # added to the name of a joint for pinocchio, where a link has the same
_SLIDE = "JointModelP"  # begins the names of prismatic joints; planar ones are refused before
_KINDS = ("JointModelR", _SLIDE)
TURN = np.pi  # [rad] to either side, within which motion of a joint without ends is planned


@dataclass(frozen=True)
class Chain:
    """The joints of an arm that turn or slide; all others are locked where they are neutral."""

    model: pin.Model
    locked: tuple[str, ...]  # names of joints
    turning: tuple[str, ...]  # names of the revolute joints without ends
    sliding: tuple[bool, ...]  # (n,)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints as the description has them."""
        return tuple(name.removesuffix(JOINT) for name in self.model.names)[1:]


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
        raise ConfigError("has no joint that turns or slides", path=path)
    model = pin.buildReducedModel(full, locked, pin.neutral(full))
    sliding = tuple(joint.shortname().startswith(_SLIDE) for joint in list(model.joints)[1:])
    return Chain(model, names, turning, sliding)


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
    named = [index for index in frames if model.frames[index].name in {"flange", "tool0"}]
    return (named or frames)[0 if named else -1]


def _with_ends(description: RobotDescription) -> tuple[str, tuple[str, ...]]:
    """Return the text with an end to either side of each continuous joint, and their names.

    Links and joints may share names in a file; in pinocchio, both are frames.
    """
    root = deepcopy(description.root)
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
