"""Read a description, URDF or MJCF, with the joints that are chosen."""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.descriptions.description import JointDynamics, RobotDescription
from limo_driver.descriptions.geometry import numbers, rotation_of, rpy_of, turned
from limo_driver.descriptions.xml_text import read_xml
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.types import FloatArray

_MOVABLE: Final = ("revolute", "continuous", "prismatic")
_NUMBERS: Final = {
    "link": ("inertial/mass", "inertial/inertia", "inertial/origin"),
    "joint": ("origin", "axis", "limit"),
}


def read_description(path: Path, joints: Sequence[str] = ()) -> RobotDescription:
    """Read a URDF or an MJCF file.

    Args:
        path: The file.
        joints: Names or patterns of the joints that move, and `name=position` of those that are
            locked elsewhere than at zero; all that can move if none is given.

    Raises:
        ConfigError: It is neither, names something twice, or has no joint of these names.
    """
    root = read_xml(path)
    if root.tag == "mujoco":
        from limo_driver.descriptions.mjcf import read_mjcf

        found = read_mjcf(path)
    elif root.tag == "robot":
        found = _of_urdf(root, path)
    else:
        raise ConfigError(
            f"is neither URDF nor MJCF: its outermost element is <{root.tag}>", path=path
        )
    return _chosen(found, joints)


def _of_urdf(root: ET.Element, path: Path) -> RobotDescription:
    for kind in ("link", "joint"):
        names = [str(item.get("name")) for item in root.findall(kind)]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ConfigError(f"has more than one {kind} called {', '.join(repeated)}", path=path)
    _refuse_floating(root, path)
    _check_numbers(root, path)
    dynamics: dict[str, JointDynamics] = {}
    for joint in root.findall("joint"):
        stated = joint.find("dynamics")
        if stated is not None:
            dynamics[str(joint.get("name"))] = JointDynamics(
                friction=_number(stated, "friction", path), damping=_number(stated, "damping", path)
            )
    return RobotDescription(root, path, "URDF", dynamics)


def _refuse_floating(root: ET.Element, path: Path) -> None:
    for joint in root.findall("joint"):
        if joint.get("type") in {"floating", "planar"}:
            raise ConfigError(
                f"joint {joint.get('name')} is {joint.get('type')}; limo's arms stand on a fixed "
                "base",
                path=path,
            )


def _check_numbers(root: ET.Element, path: Path) -> None:
    """Refuse what the parser would leave out silently, all other masses with it.

    Raises:
        ConfigError: Names the link or joint, and what is no finite number.
    """
    for kind, parts in _NUMBERS.items():
        for owner in root.findall(kind):
            for part in parts:
                for element in owner.findall(part):
                    _check_element(f"{kind} {owner.get('name')!r}", element, path)


def _check_element(owner: str, element: ET.Element, path: Path) -> None:
    for name, text in element.attrib.items():
        for word in text.split():
            try:
                value = float(word)
            except ValueError:
                value = np.nan
            if not np.isfinite(value) or (element.tag == "mass" and value < 0.0):
                expected = "0 or more" if element.tag == "mass" else "a finite number"
                raise ConfigError(
                    f"{owner}: {name} of its {element.tag} is {word}, expected {expected}",
                    path=path,
                )


def _number(element: ET.Element, name: str, path: Path) -> float:
    text = element.get(name, "0")
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or value < 0:
        raise ConfigError(f"<{element.tag}> has {name}={text!r}, expected 0 or more", path=path)
    return value


def _chosen(found: RobotDescription, joints: Sequence[str]) -> RobotDescription:
    """Fix the joints that are not chosen, and those that only follow others."""
    positions = {
        name.strip(): value for name, mark, value in (x.partition("=") for x in joints) if mark
    }
    patterns = [pattern for pattern in joints if "=" not in pattern]
    movable = {
        str(joint.get("name")): joint
        for joint in found.root.findall("joint")
        if joint.get("type") in _MOVABLE
    }
    for name in positions:
        if name not in movable:
            raise ConfigError(_unknown(name, list(movable)), path=found.path)
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in movable):
            raise ConfigError(_unknown(pattern, list(movable)), path=found.path)
    notes = list(found.notes)
    for name, joint in movable.items():
        wanted = not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)
        mimic = joint.find("mimic")
        if wanted and name not in positions and mimic is None:
            continue
        at = _position(positions.get(name, "0"), name, found.path)
        why = f", which follows {mimic.get('joint')}" if mimic is not None else ""
        notes.append(f"joint {name}{why} is locked at {at:g}; what it carries is lumped")
        _fix(joint, at)
    return replace(found, notes=tuple(notes))


def _unknown(name: str, known: list[str]) -> str:
    return f"has no joint {name!r} that moves; it has {', '.join(known) or 'none'}"


def _position(text: str, name: str, path: Path) -> float:
    try:
        return float(text)
    except ValueError:
        raise ConfigError(
            f"joint {name} is to be locked at {text!r}, expected a number", path=path
        ) from None


def _fix(joint: ET.Element, at: float) -> None:
    """Make a joint a fixed one at a position [rad, m]."""
    kind = joint.get("type")
    joint.set("type", "fixed")
    for name in ("limit", "mimic", "dynamics", "safety_controller"):
        for child in joint.findall(name):
            joint.remove(child)
    if not at:
        return
    stated = joint.find("axis")
    axis = _vector("1 0 0" if stated is None else stated.get("xyz", "1 0 0"))
    axis /= np.linalg.norm(axis)
    origin = joint.find("origin")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    place = _vector(origin.get("xyz", "0 0 0"))
    rotation = rotation_of(_vector(origin.get("rpy", "0 0 0")))
    if kind == "prismatic":
        place = place + rotation @ axis * at
    else:
        rotation = rotation @ turned(axis, at)
    origin.set("xyz", numbers(place))
    origin.set("rpy", numbers(rpy_of(rotation)))


def _vector(text: str) -> FloatArray:
    return np.array([float(part) for part in text.split()])
