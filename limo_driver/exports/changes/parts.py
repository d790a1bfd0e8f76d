"""Parts: the bodies of a description that move with each joint, and where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.exports.changes.bodies import BodyPart
from limo_driver.model.descriptions.geometry import rotation_of
from limo_driver.model.descriptions.inertial import Inertial

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

_KEYS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


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
