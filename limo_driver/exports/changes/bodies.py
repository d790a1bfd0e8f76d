"""Bodies of a file: how they share the inertia of a link, and those that an earlier export added.

A comment at the end of the file lists the loads among them: `<!-- limo added: {"payload": {"on":
"link7", "mass": 0.9, "com": [0, 0, 0.1], "inertia": [...]}} -->`. A body that somebody has changed
since is the user's, and stays. So does one that the simulation counts to the link: who goes on with
the exported file as robot has the load in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.exports.changes.origin import read_comment, write_comment
from limo_driver.model.descriptions.geometry import Inertial, rotation_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from xml.etree import ElementTree as ET

    from limo_driver.exports.xml_edits import XmlText
    from limo_driver.model import RobotModel
    from limo_driver.physics import Payload
    from limo_driver.types import FloatArray

_SEVERAL: Final = 2
SAME: Final = 1e-9  # relative change of a second moment that is none
_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class BodyPart:
    """A body of a file that moves rigidly with a link."""

    name: str
    inertial: Inertial | None  # in its own frame; None where it has no mass
    pose: FloatArray  # (4, 4), of its frame in that of the link


def pseudo_inertia(body: Inertial) -> FloatArray:
    """Return the second moments of mass about the origin, (4, 4): linear in all parameters."""
    h = body.mass * np.array(body.com)
    tensor = body.tensor()
    about_com = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    J = np.zeros((4, 4))
    J[:3, :3] = about_com + np.outer(h, h) / body.mass
    J[:3, 3] = J[3, :3] = h
    J[3, 3] = body.mass
    return J


def inertial_of(J: FloatArray) -> Inertial:
    """Return the body that has these second moments of mass."""
    mass = float(J[3, 3])
    com = J[:3, 3] / mass
    about_com = J[:3, :3] - mass * np.outer(com, com)
    tensor = np.trace(about_com) * np.eye(3) - about_com
    x, y, z = com.tolist()
    xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
    return Inertial(mass, (x, y, z), (xx, xy, xz, yy, yz, zz))


def shared(parts: tuple[BodyPart, ...], wanted: Inertial) -> Mapping[str, Inertial]:
    """Return new inertias of the parts of a link that together make the wanted one.

    The link's own body takes all of the change, if it is a possible body then; else the wanted
    inertia is shared by all of them in proportion to their masses. Parts that do not change are
    left out.

    Args:
        parts: The link's own body first.
        wanted: Of all of them together, in the frame of the link.
    """
    J = [np.zeros((4, 4)) if p.inertial is None else moved(p.inertial, p.pose) for p in parts]
    target = pseudo_inertia(wanted)
    change = target - sum(J)
    scale = np.sqrt(np.outer(np.diag(target), np.diag(target)))
    if (np.abs(change) <= SAME * scale).all():
        return {}
    own = _in_frame(J[0] + change, parts[0].pose)
    if own[3, 3] > 0 and (body := inertial_of(own)).is_consistent():
        return {parts[0].name: body}
    masses = np.array([each[3, 3] for each in J])
    shares = masses / masses.sum()
    return {
        part.name: inertial_of(_in_frame(share * target, part.pose))
        for part, share in zip(parts, shares.tolist(), strict=True)
        if share > 0
    }


def rescaled_lines(
    parts: Sequence[BodyPart], changes: Mapping[str, Inertial], wanted: Inertial
) -> list[str]:
    """Say by how much the bodies beside a link's own change, where that one cannot take it all.

    Args:
        parts: As for `shared`.
        changes: What that returned.
        wanted: Of all of them together.
    """
    if len(changes) < _SEVERAL:
        return []
    names = ", ".join(changes)
    weight = sum(part.inertial.mass for part in parts if part.inertial is not None)
    return [
        f"what {names} weigh: {weight:.3g} kg in the file, {wanted.mass:.3g} kg in the "
        "simulation, and all of them change in proportion; to keep them, let the file be the "
        "simulation's robot"
    ]


def moved(body: Inertial, pose: FloatArray) -> FloatArray:
    """Return the second moments of mass of a body in the frame in which its own is at a pose."""
    return pose @ pseudo_inertia(body) @ pose.T


def _in_frame(J: FloatArray, pose: FloatArray) -> FloatArray:
    inverse = np.linalg.inv(pose)
    return inverse @ J @ inverse.T


def parts_of(model: RobotModel) -> dict[str, tuple[BodyPart, ...]]:
    """Return the bodies that move rigidly with each link, itself first, by name of the link.

    Frames are those of the file: in MJCF, a body's is not that of its joint.

    Args:
        model: A robot as its file describes it.
    """
    root = model.description.root
    children: dict[str, list[tuple[ET.Element, str]]] = {}
    moved_by: dict[str, str] = {}  # joint → link
    for joint in root.findall("joint"):
        parent, child = _link(joint, "parent"), _link(joint, "child")
        children.setdefault(parent, []).append((joint, child))
        moved_by[str(joint.get("name"))] = child
    links = {str(link.get("name")): link for link in root.findall("link")}
    moving = {moved_by[name] for name in model.link_joints}
    found: dict[str, tuple[BodyPart, ...]] = {}
    for name in model.link_joints:
        own = moved_by[name]
        parts, waiting = list[BodyPart](), [(own, np.eye(4))]
        while waiting:
            link, pose = waiting.pop(0)
            shift = np.eye(4)
            shift[:3, 3] = -model.description.shifts.get(link, np.zeros(3))
            body = _inertial(links[link])
            if body is not None:
                x, y, z = (np.array(body.com) - shift[:3, 3]).tolist()
                body = Inertial(body.mass, (x, y, z), body.inertia)
            if body is not None or link == own:
                parts.append(BodyPart(link, body, pose @ shift))
            waiting += [
                (child, pose @ origin_of(joint))
                for joint, child in children.get(link, [])
                if child not in moving
            ]
        found[own] = tuple(parts)
    return found


def origin_of(element: ET.Element) -> FloatArray:
    """Return the pose that an element's origin states, (4, 4)."""
    origin, pose = element.find("origin"), np.eye(4)
    if origin is not None:
        pose[:3, 3] = _vector(origin, "xyz")
        pose[:3, :3] = rotation_of(_vector(origin, "rpy"))
    return pose


def _inertial(link: ET.Element) -> Inertial | None:
    stated = link.find("inertial")
    mass = None if stated is None else stated.find("mass")
    if stated is None or mass is None or float(mass.get("value", "0")) <= 0:
        return None
    pose, entries = origin_of(stated), stated.find("inertia")
    values = [float("0" if entries is None else entries.get(key, "0")) for key in _KEYS]
    tensor = np.zeros((3, 3))
    tensor[np.triu_indices(3)] = values
    tensor = tensor + np.triu(tensor, 1).T
    tensor = pose[:3, :3] @ tensor @ pose[:3, :3].T
    xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
    x, y, z = pose[:3, 3].tolist()
    return Inertial(float(mass.get("value", "0")), (x, y, z), (xx, xy, xz, yy, yz, zz))


def _link(joint: ET.Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _vector(element: ET.Element, name: str) -> FloatArray:
    return np.array([float(part) for part in element.get(name, "0 0 0").split()])


_TITLE: Final = "limo added"
_NAME: Final = "payload"
_SAME: Final = 1e-6  # relative, of second moments: files round to ten digits, simulators turn axes


@dataclass(frozen=True)
class AddedBody:
    """A body that an export added."""

    on: str  # link that carries it
    body: Inertial  # in its own frame, as it was written


def added_bodies(text: XmlText) -> dict[str, AddedBody]:
    """Return the bodies that earlier exports added, by name; of no or an unusable comment, none.

    Args:
        text: The file.
    """
    said = read_comment(text, _TITLE)
    try:
        return {str(name): _entry(entry) for name, entry in (said or {}).items()}
    except (ValueError, TypeError, KeyError, AttributeError):
        return {}


def still_there(
    added: Mapping[str, AddedBody], parts: Iterable[Sequence[BodyPart]]
) -> dict[str, AddedBody]:
    """Return those of the added bodies that are still in a file as they were written.

    Args:
        added: By name.
        parts: Bodies that move with each link, its own first.
    """
    return {
        part.name: added[part.name]
        for of_link in parts
        for part in of_link[1:]
        if part.name in added
        and added[part.name].on == of_link[0].name
        and part.inertial is not None
        and _alike(added[part.name].body, part.inertial)
    }


def write_added(text: XmlText, added: Mapping[str, AddedBody]) -> None:
    """Write which bodies exports added.

    Args:
        text: The file.
        added: By name.
    """
    write_comment(
        text,
        _TITLE,
        {
            name: {
                "on": each.on,
                "mass": _rounded(each.body.mass),
                "com": [_rounded(x) for x in each.body.com],
                "inertia": [_rounded(x) for x in each.body.inertia],
            }
            for name, each in added.items()
        },
    )


def replaced_bodies(
    parts: Sequence[BodyPart], added: Mapping[str, AddedBody], wanted: Inertial
) -> tuple[str, ...]:
    """Return the added bodies that a simulation does not count to a link, by name.

    One after the other is taken away, as long as what is left comes nearer to the simulation's
    link.

    Args:
        parts: Bodies of the file that move with the link, its own first.
        added: Bodies that exports added, as far as they are still there.
        wanted: The link in the simulation, in its own frame and without loads.
    """
    there = {
        part.name: moved(part.inertial, part.pose)
        for part in parts
        if part.inertial is not None and part.name in added
    }
    whole = sum(
        (moved(part.inertial, part.pose) for part in parts if part.inertial is not None),
        np.zeros((4, 4)),
    )
    target, gone = pseudo_inertia(wanted), list[str]()
    scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole))) + np.finfo(float).tiny
    while there:
        nearest = min(there, key=lambda name: _apart(whole - there[name], target, scale))
        less = whole - there.pop(nearest)
        if _apart(less, target, scale) >= _apart(whole, target, scale):
            break
        whole, gone = less, [*gone, nearest]
    return tuple(part.name for part in parts if part.name in gone)


def placed(
    payloads: Sequence[Payload], replaced: Sequence[str], taken: Collection[str]
) -> dict[str, Payload]:
    """Return under which name each load stands: those of replaced bodies first.

    Args:
        payloads: Of the simulation.
        replaced: Names of bodies that stand in the file and are put anew.
        taken: Names that the file has.
    """
    fresh = (
        name
        for number in count()
        if (name := _NAME if not number else f"{_NAME}_{number}") not in taken
    )
    names = [*replaced, *(next(fresh) for _ in payloads[len(replaced) :])]
    return dict(zip(names, payloads, strict=False))


def gone_lines(
    replaced: Iterable[str], loads: Collection[str], added: Mapping[str, AddedBody]
) -> tuple[str, ...]:
    """Say which bodies go, as the simulation has fewer loads.

    Args:
        replaced: Names of bodies that are put anew, or go.
        loads: Names of those that stay.
        added: Bodies that exports added.
    """
    return tuple(
        f"body {name} of {added[name].body.mass:.4g} kg on {added[name].on}, which an earlier "
        "export added; the simulation has it no longer"
        for name in replaced
        if name not in loads
    )


def _entry(entry: Mapping[str, Any]) -> AddedBody:
    x, y, z = map(float, entry["com"])
    xx, xy, xz, yy, yz, zz = map(float, entry["inertia"])
    body = Inertial(float(entry["mass"]), (x, y, z), (xx, xy, xz, yy, yz, zz))
    return AddedBody(str(entry["on"]), body)


def _alike(first: Inertial, second: Inertial) -> bool:
    one, other = (pseudo_inertia(body) for body in (first, second))
    size = np.abs(np.diag(one))
    return bool((np.abs(one - other) <= _SAME * np.sqrt(np.outer(size, size)) + 1e-12).all())


def _apart(first: FloatArray, second: FloatArray, scale: FloatArray) -> float:
    return float(np.linalg.norm((first - second) / scale))


def _rounded(value: float) -> float:
    return float(f"{value:.10g}")
