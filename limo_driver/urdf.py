"""Reads the chain of revolute joints of a URDF, as pinocchio has it."""

# pinocchio has no stubs and is found through an import hook; this file and `model` are the adapter.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree as ET

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

TURN = np.pi  # [rad] to either side, within which motion of a joint without ends is planned


@dataclass(frozen=True)
class Chain:
    """The revolute joints of an arm; all others are locked where they are neutral."""

    model: pin.Model
    locked: tuple[str, ...]  # names of joints
    turning: tuple[str, ...]  # names of the revolute joints without ends


def read_chain(urdf: Path) -> Chain:
    """Read the joints of an arm.

    A continuous joint becomes a revolute one, whose position counts the turns: pinocchio would
    describe it by the point on a circle, which a recording does not.

    Args:
        urdf: The file.

    Raises:
        ConfigError: It is no URDF, or has no revolute joint.
    """
    try:
        text, turning = _with_ends(urdf)
        full = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError, IndexError, ET.ParseError) as error:
        raise ConfigError(f"cannot be read as a URDF: {error}", path=urdf) from None
    locked = [
        index
        for index in range(1, full.njoints)
        if not full.joints[index].shortname().startswith("JointModelR")
    ]
    names = tuple(full.names[index] for index in locked)
    if len(locked) == full.njoints - 1:
        raise ConfigError("has no revolute joint", path=urdf)
    return Chain(pin.buildReducedModel(full, locked, pin.neutral(full)), names, turning)


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


def _with_ends(urdf: Path) -> tuple[str, tuple[str, ...]]:
    """Return the text with an end to either side of each continuous joint, and their names."""
    root = ET.parse(urdf).getroot()  # noqa: S314  # the user's own file
    _check_numbers(root, urdf)
    joints = [joint for joint in root.findall("joint") if joint.get("type") == "continuous"]
    for joint in joints:
        joint.set("type", "revolute")
        limit = joint.find("limit")
        if limit is None:
            limit = ET.SubElement(joint, "limit", effort="0", velocity="0")
        limit.set("lower", repr(-TURN))
        limit.set("upper", repr(TURN))
    return ET.tostring(root, encoding="unicode"), tuple(str(j.get("name")) for j in joints)


def _check_numbers(root: ET.Element, urdf: Path) -> None:
    """Refuse what the parser would leave out silently, all other masses with it.

    Raises:
        ConfigError: Names the link or joint, and what is no finite number.
    """
    for kind, parts in _NUMBERS.items():
        for owner in root.findall(kind):
            for part in parts:
                for element in owner.findall(part):
                    _check_element(f"{kind} {owner.get('name')!r}", element, urdf)


def _check_element(owner: str, element: ET.Element, urdf: Path) -> None:
    for name, text in element.attrib.items():
        for word in text.split():
            try:
                value = float(word)
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or (element.tag == "mass" and value < 0.0):
                expected = "0 or more" if element.tag == "mass" else "a finite number"
                raise ConfigError(
                    f"{owner}: {name} of its {element.tag} is {word}, expected {expected}",
                    path=urdf,
                )


_NUMBERS: Final = {
    "link": ("inertial/mass", "inertial/inertia", "inertial/origin"),
    "joint": ("origin", "axis", "limit"),
}
