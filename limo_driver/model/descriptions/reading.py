"""Read a description, URDF, MJCF or USD, with the joints that are chosen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final, cast
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import (
    Following,
    JointDynamics,
    RobotDescription,
    read_xml,
)
from limo_driver.model.descriptions.geometry import numbers, rotation_of, rpy_of, turned
from limo_driver.model.descriptions.urdf_checks import (
    check_urdf,
    end_of,
    mended,
    plain,
    unranged_notes,
    with_plain_numbers,
    without_ends,
)
from limo_driver.runtime.display import shortened
from limo_driver.runtime.given_files import apart
from limo_driver.types import FloatArray

USD_ENDINGS: Final = (".usd", ".usda", ".usdc", ".usdz")
_TURNING: Final = ("revolute", "continuous")
_SLIDING: Final = "prismatic"
_MOVABLE: Final = (*_TURNING, _SLIDING)
_DYNAMICS: Final = ("friction", "damping")
# Of a joint that follows another; its friction, damping and armature are felt at that one.
_NOT_FELT: Final = {
    "spring": ("stiffness", "cubic"),
    "drag": ("drag",),
    "friction with memory": ("bristles", "slips"),
    "cogging": ("ripples",),
    "play": ("gap", "gap_damping"),
}


def read_description(path: Path, joints: Sequence[str] = ()) -> RobotDescription:
    """Read a URDF, MJCF or USD file.

    Args:
        path: The file.
        joints: Names or patterns of the joints that move, and `name=position` of those that are
            locked there; all that can move if none is given.

    Raises:
        ConfigError: It is neither, names something twice, or has no joint of these names.
    """
    if path.suffix.lower() in USD_ENDINGS:
        from limo_driver.model.descriptions.usd import read_usd

        return _chosen(apart(read_usd, path, ConfigError), joints)
    root = read_xml(path)
    if root.tag == "mujoco":
        from limo_driver.model.descriptions.mjcf import read_mjcf

        found = read_mjcf(path, joints)
    elif root.tag == "robot":
        found = _of_urdf(root, path)
    else:
        reason = f"is neither URDF nor MJCF: its outermost element is <{root.tag}>"
        if root.tag == "mujocoinclude":
            reason = "is a part that MJCF files include; expected the file that includes it"
        raise ConfigError(reason, path=path)
    return _chosen(found, joints)


def _of_urdf(root: ET.Element, path: Path) -> RobotDescription:
    notes = mended(root, path)
    check_urdf(root, path)
    with_plain_numbers(root)
    unranged = without_ends(root)
    dynamics: dict[str, JointDynamics] = {}
    for joint in root.findall("joint"):
        stated = joint.find("dynamics")
        if stated is not None:
            friction, damping = (_number(stated, name, path, least=0.0) for name in _DYNAMICS)
            dynamics[str(joint.get("name"))] = JointDynamics(friction, damping)
            stated.attrib |= {"friction": plain(repr(friction)), "damping": plain(repr(damping))}
    return RobotDescription(root, path, "URDF", dynamics, notes=notes, unranged=unranged)


def _number(
    element: ET.Element, name: str, path: Path, default: str = "0", least: float = -np.inf
) -> float:
    text = element.get(name, default)
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or value < least:
        expected = "a finite number" if np.isinf(least) else f"{least:g} or more"
        raise ConfigError(f"<{element.tag}> has {name}={text!r}, expected {expected}", path=path)
    return value


def _chosen(found: RobotDescription, joints: Sequence[str]) -> RobotDescription:
    """Fix the joints that are not chosen, those of grippers, and what only follows such."""
    movable = {
        str(joint.get("name")): joint
        for joint in found.root.findall("joint")
        if joint.get("type") in _MOVABLE
    }
    patterns = [pattern for pattern in joints if pattern in movable or "=" not in pattern]
    chosen: set[str] = set()
    for pattern in patterns:
        # A name that looks like a pattern stands for itself where there is such a joint.
        own = pattern in movable
        match = [pattern] if own else [name for name in movable if fnmatchcase(name, pattern)]
        if not match:
            raise ConfigError(_unknown(pattern, list(movable)), path=found.path)
        chosen.update(match)
    held = _held([item for item in joints if item not in movable], list(movable), found.path)
    wanted = [
        name
        for name, joint in movable.items()
        if (not patterns or name in chosen) and name not in held and joint.find("mimic") is None
    ]
    gripping = frozenset[str]() if patterns else _grippers(found.root, wanted, found.loops)
    moving = set(wanted) - gripping
    in_loops = frozenset[str]().union(*found.loops)
    following = _following(movable, held, found.path)
    followers = {
        name: item for name, item in following.items() if item.leader in moving and item.ratio
    }
    _check_chosen(patterns, moving, following, found.path)
    places = _places(movable, moving | followers.keys(), held, following, found.path)
    told: dict[tuple[float, str], list[str]] = {}
    for name, at in places.items():
        why = ""
        if name in following:
            why = f", which follows {_leader(movable[name])}{_missing(name, movable, found.root)},"
        elif movable[name].find("mimic") is not None and not _leader(movable[name]):
            why = ", whose <mimic> names no joint,"
        elif name in gripping:
            why = ", at the end of which none turns,"
            if name in in_loops:
                why = " of a loop that bodies close, at the end of which none turns,"
        if name in held:
            why += _out_of_range(movable[name], at, found.path)
        told.setdefault((at, why), []).append(name)
        _fix(movable[name], at)
    notes = [_locked(names, at, why) for (at, why), names in told.items()]
    notes += [
        f"joint {name} follows {item.leader}: {item.ratio:g} times its position"
        + (f" {'-' if item.offset < 0 else '+'} {abs(item.offset):g}" if item.offset else "")
        for name, item in followers.items()
    ]
    notes += [
        f"not represented: {what} of joint {name}, which follows {item.leader}"
        for name, item in followers.items()
        for what, keys in _NOT_FELT.items()
        if any(getattr(found.dynamics.get(name), key, None) for key in keys)
    ]
    free = [name for name in found.unranged if name not in places and name not in followers]
    slides = [name for name in free if movable[name].get("type") == _SLIDING]
    notes += unranged_notes(free, slides)
    return replace(
        found,
        notes=(*found.notes, *notes),
        locked=places,
        followers=followers,
        led={name: item.leader for name, item in following.items() if name in places},
        unranged=tuple(free),
    )


def _following(
    movable: dict[str, ET.Element], held: dict[str, float], path: Path
) -> dict[str, Following]:
    """Return how each joint that is not held follows the one that leads it in the end.

    Raises:
        ConfigError: Joints follow each other in a circle, or by no finite number.
    """
    stated = {name: joint for name, joint in movable.items() if _leader(joint) and name not in held}
    found: dict[str, Following] = {}
    for name in stated:
        leader, ratio, offset = name, 1.0, 0.0
        for _ in stated:
            if leader not in stated:
                break
            mimic = cast("ET.Element", stated[leader].find("mimic"))
            own = _number(mimic, "multiplier", path, "1")
            offset += ratio * _number(mimic, "offset", path)
            ratio, leader = ratio * own, _leader(stated[leader])
        if leader in stated:
            raise ConfigError(f"joint {name} follows itself, by way of others", path=path)
        found[name] = Following(leader, ratio, offset)
    return found


def _check_chosen(
    patterns: Sequence[str], moving: set[str], following: dict[str, Following], path: Path
) -> None:
    """Refuse a joint chosen by its name that follows one which is not.

    Raises:
        ConfigError: There is one.
    """
    for name in patterns:
        if name in following and (leader := following[name].leader) not in moving:
            raise ConfigError(
                f"joint {name} follows {leader}, which is not chosen: choose {leader} instead",
                path=path,
            )


def _places(
    movable: dict[str, ET.Element],
    moving: set[str],
    held: dict[str, float],
    following: dict[str, Following],
    path: Path,
) -> dict[str, float]:
    """Return where each joint that does not move is locked [rad, m].

    Where nothing is stated, that is the place nearest to zero that it can reach; of a joint that
    follows another, what that other makes of it.
    """
    places = {
        name: held.get(name, _nearest_to_zero(joint, path))
        for name, joint in movable.items()
        if name not in moving
    }
    for name, item in following.items():
        if name in places:
            places[name] = item.offset + item.ratio * places.get(item.leader, 0.0)
    return places


def _missing(name: str, movable: dict[str, ET.Element], root: ET.Element) -> str:
    """Say that the joint which another one follows is not in the file, where it is not."""
    joints = {joint.get("name") for joint in root.findall("joint")}
    return "" if _leader(movable[name]) in joints else " (which is not there)"


def _leader(joint: ET.Element) -> str:
    """Return the joint that this one follows; nothing if it follows none."""
    mimic = joint.find("mimic")
    return "" if mimic is None else mimic.get("joint", "")


def _nearest_to_zero(joint: ET.Element, path: Path) -> float:
    stated = _range_of(joint, path)
    return 0.0 if stated is None else min(max(0.0, stated[0]), stated[1])


def _range_of(joint: ET.Element, path: Path) -> tuple[float, float] | None:
    """Return the least and the greatest position of a joint [rad, m]; None if it states none."""
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return None
    lower, upper = (_number(limit, name, path) for name in ("lower", "upper"))
    return (lower, upper) if lower < upper else None


def _out_of_range(joint: ET.Element, at: float, path: Path) -> str:
    """Say how far a joint goes that is to be locked where it cannot be; nothing where it can."""
    stated = _range_of(joint, path)
    if stated is None or stated[0] <= at <= stated[1]:
        return ""
    unit = "m" if joint.get("type") == _SLIDING else "rad"
    return f", whose range is {stated[0]:g} to {stated[1]:g} {unit},"


def _locked(names: Sequence[str], at: float, why: str) -> str:
    if len(names) == 1:
        return f"joint {names[0]}{why} is locked at {at:g}; what it carries is lumped"
    why = why.replace("follows", "follow")
    return f"joints {shortened(names)}{why} are locked at {at:g}; what they carry is lumped"


def _held(joints: Sequence[str], known: list[str], path: Path) -> dict[str, float]:
    """Return the positions [rad, m] of the joints that are to be locked at some."""
    held: dict[str, float] = {}
    for name, mark, text in (joint.partition("=") for joint in joints):
        if mark:
            if name.strip() not in known:
                raise ConfigError(_unknown(name.strip(), known), path=path)
            held[name.strip()] = _position(text, name.strip(), path)
    return held


def _grippers(
    root: ET.Element, wanted: list[str], loops: Sequence[frozenset[str]]
) -> frozenset[str]:
    """Return the joints that slide, lead others beside them or are part of a loop of bodies.

    Those that carry a joint that turns freely are none, and nobody is if nothing else is left that
    moves.
    """
    in_loops = frozenset[str]().union(*loops)
    children: dict[str, list[ET.Element]] = {}
    followers: dict[str, list[str]] = {}
    for joint in root.findall("joint"):
        children.setdefault(end_of(joint, "parent"), []).append(joint)
        followers.setdefault(_leader(joint), []).append(str(joint.get("name")))

    def beyond(joint: ET.Element) -> Iterator[ET.Element]:
        for each in children.get(end_of(joint, "child"), []):
            yield each
            yield from beyond(each)

    def turns_beyond(joint: ET.Element) -> bool:
        return any(
            each.get("type") in _TURNING
            and each.find("mimic") is None
            and each.get("name") not in in_loops
            for each in beyond(joint)
        )

    def leads(joint: ET.Element) -> bool:
        """Say whether a slide follows it, or what it does not carry, as a finger does another."""
        carried = {str(x.get("name")) for x in beyond(joint) if x.get("type") in _TURNING}
        return not carried.issuperset(followers.get(str(joint.get("name")), []))

    found = frozenset(
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("name") in wanted
        and (joint.get("type") == _SLIDING or joint.get("name") in in_loops or leads(joint))
        and not turns_beyond(joint)
    )
    return found if set(wanted) - found else frozenset()


def _unknown(name: str, known: list[str]) -> str:
    return f"has no joint {name!r} that moves; it has {', '.join(known) or 'none'}"


def _position(text: str, name: str, path: Path) -> float:
    try:
        at = float(text)
    except ValueError:
        at = np.nan
    if not np.isfinite(at):
        raise ConfigError(
            f"joint {name} is to be locked at {text!r}, expected a finite number", path=path
        )
    return at


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
    if kind == _SLIDING:
        place = place + rotation @ axis * at
    else:
        rotation = rotation @ turned(axis, at)
    origin.set("xyz", numbers(place))
    origin.set("rpy", numbers(rpy_of(rotation)))


def _vector(text: str) -> FloatArray:
    return np.array([float(part) for part in text.split()])
