"""ArmWriter: a tree of bodies of MuJoCo's model, written as links and joints of a URDF.

The frame of a link is that of its body, moved to the joint's anchor.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.model.descriptions.description import ROOM, SITE, JointDynamics
from limo_driver.model.descriptions.geometry import numbers, rpy_of, turned
from limo_driver.model.descriptions.mjcf.joints import (
    HINGE,
    SLIDE,
    body_name,
    dynamics,
    effort,
    joint_name,
    play_of,
)
from limo_driver.runtime.installed_mujoco import mujoco
from limo_driver.types import FloatArray

TURNING: Final = {HINGE: "revolute", SLIDE: "prismatic"}
_POLYNOMIAL: Final = 5  # coefficients of an equality of joints


class ArmWriter:
    """Writes one tree of bodies as links and joints."""

    def __init__(self, model: Any, root: int) -> None:  # noqa: ANN401
        self.model = model
        self.robot = ET.Element("robot", name=Path(body_name(model, root)).stem)
        self.dynamics: dict[str, JointDynamics] = {}
        self.shifts: dict[str, FloatArray] = {}
        self.hulls: dict[str, FloatArray] = {}
        self.notes: list[str] = []
        self.plays: dict[str, str] = {}  # joint → the hinge that is its play
        ET.SubElement(self.robot, "link", name="world")

    def write(self, body: int) -> None:
        """Write a body with its joint, its inertia and shapes, and all bodies that it carries."""
        # The joints of a body; one that lets it float is none, with a note
        first, many = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        every = range(first, first + many)
        free = [joint for joint in every if int(self.model.jnt_type[joint]) not in TURNING]
        self.notes += [
            f"the base is taken to stand still: {joint_name(self.model, joint)} would let it float"
            for joint in free
        ]
        name, joints = body_name(self.model, body), [joint for joint in every if joint not in free]
        play = play_of(self.model, joints)
        if play is not None:
            joints.remove(play)
        joint = joints[-1] if joints else None
        anchor = np.zeros(3) if joint is None else np.array(self.model.jnt_pos[joint])
        self.shifts[name] = anchor
        link = ET.SubElement(self.robot, "link", name=name)
        self._inertial(link, body, anchor)
        self._shapes(link, body, anchor)
        self._joints_of(name, body, joints)
        if joint is not None and play is not None:
            # Take a second hinge of a body for the backlash of its joint
            title, own = joint_name(self.model, joint), joint_name(self.model, play)
            low, high = self.model.jnt_range[play].tolist()
            self.plays[title] = own
            damping = float(self.model.dof_damping[self.model.jnt_dofadr[play]])
            known = self.dynamics[title]
            self.dynamics[title] = replace(known, gap=high - low, gap_damping=damping)
            self.notes.append(
                f"joint {own} has no actuator and {high - low:.3g} rad of range: it is the play of "
                f"{title}, about the middle of that range"
            )
        for site in np.flatnonzero(self.model.site_bodyid == body).tolist():
            self._site(name, site, anchor)
        for child in np.flatnonzero(self.model.body_parentid == body).tolist():
            if child != body:
                self.write(child)

    def couple(self) -> int:
        """Let joints follow others as equalities have them do; return how many are so met."""
        model, coupled = self.model, 0
        written = {str(joint.get("name")): joint for joint in self.robot.findall("joint")}
        for k in range(model.neq):
            first, second = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            offset, ratio, *higher = model.eq_data[k][:_POLYNOMIAL].tolist()
            of_joints = int(model.eq_type[k]) == int(mujoco.mjtEq.mjEQ_JOINT) and second >= 0
            if not (of_joints and model.eq_active0[k]) or any(higher):
                continue
            follower = written.get(joint_name(model, first))
            if follower is None or follower.find("mimic") is not None:
                continue
            start = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second)]
            ET.SubElement(
                follower,
                "mimic",
                joint=joint_name(model, second),
                multiplier=repr(ratio),
                offset=repr(offset + start[0] - ratio * start[1]),
            )
            coupled += 1
        return coupled

    def _parent(self, body: int) -> tuple[str, FloatArray]:
        parent = int(self.model.body_parentid[body])
        if not parent:
            return "world", np.zeros(3)
        name = body_name(self.model, parent)
        return name, self.shifts[name]

    def _joints_of(self, name: str, body: int, joints: list[int]) -> None:
        """Write the joints of a body one after the other, with a frame between each two."""
        model = self.model
        parent, shift = self._parent(body)
        place, rotation = np.array(model.body_pos[body]) - shift, _matrix(model.body_quat[body])
        if not joints:
            self._fixed(f"{name}_mount", parent, name, place, rotation)
        for k, joint in enumerate(joints):
            anchor = np.array(model.jnt_pos[joint])
            child = name if joint == joints[-1] else f"{name}_{joint_name(model, joint)}"
            if child != name:
                ET.SubElement(self.robot, "link", name=child)
            before = np.array(model.jnt_pos[joints[k - 1]]) if k else np.zeros(3)
            self._joint(joint, (parent, child), place + rotation @ (anchor - before), rotation)
            parent, place, rotation = child, np.zeros(3), np.eye(3)

    def _joint(
        self, joint: int, links: tuple[str, str], place: FloatArray, rotation: FloatArray
    ) -> None:
        model = self.model
        kind, axis = int(model.jnt_type[joint]), np.array(model.jnt_axis[joint])
        start = float(model.qpos0[model.jnt_qposadr[joint]])
        if kind == HINGE:
            rotation = rotation @ turned(axis, -start)
        else:
            place = place - rotation @ axis * start
        limited = bool(model.jnt_limited[joint])
        said = TURNING[kind] if limited or kind == SLIDE else "continuous"
        title = joint_name(model, joint)
        element = ET.SubElement(self.robot, "joint", name=title, type=said)
        _place(element, place, rotation)
        ET.SubElement(element, "parent", link=links[0])
        ET.SubElement(element, "child", link=links[1])
        ET.SubElement(element, "axis", xyz=numbers(axis))
        low, high = model.jnt_range[joint] if limited else (-ROOM, ROOM)
        bounds = {"lower": repr(float(low)), "upper": repr(float(high))}
        if kind == SLIDE and not limited:
            self.notes.append(f"joint {title} states no range; {ROOM:g} m to either side is taken")
        kept = bounds if said != "continuous" else {}
        most = repr(effort(model, joint))
        ET.SubElement(element, "limit", {**kept, "effort": most, "velocity": "0"})
        self.dynamics[title] = dynamics(model, joint)

    def _fixed(self, title: str, parent: str, child: str, place: FloatArray, R: FloatArray) -> None:
        element = ET.SubElement(self.robot, "joint", name=title, type="fixed")
        _place(element, place, R)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=child)

    def _site(self, body: str, site: int, anchor: FloatArray) -> None:
        title = self.model.site(site).name
        if not title or title in self.shifts:
            return
        ET.SubElement(self.robot, "link", name=f"{SITE}{title}")
        place = np.array(self.model.site_pos[site]) - anchor
        R = _matrix(self.model.site_quat[site])
        self._fixed(f"{SITE}{title}_mount", body, f"{SITE}{title}", place, R)

    def _inertial(self, link: ET.Element, body: int, anchor: FloatArray) -> None:
        model = self.model
        mass = float(model.body_mass[body])
        if mass <= 0:
            return
        R = _matrix(model.body_iquat[body])
        tensor = R @ np.diag(model.body_inertia[body]) @ R.T
        element = ET.SubElement(link, "inertial")
        ET.SubElement(
            element, "origin", xyz=numbers(np.array(model.body_ipos[body]) - anchor), rpy="0 0 0"
        )
        ET.SubElement(element, "mass", value=repr(mass))
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        entries = tensor[np.triu_indices(3)].tolist()
        ET.SubElement(element, "inertia", dict(zip(keys, map(repr, entries), strict=True)))

    def _shapes(self, link: ET.Element, body: int, anchor: FloatArray) -> None:
        """Write collision shapes; a mesh as the box around it, beside its corners."""
        model = self.model
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            if not (model.geom_contype[geom] or model.geom_conaffinity[geom]):
                continue
            shape = shape_of(model, geom)
            if shape is None:
                continue
            place, R = np.array(model.geom_pos[geom]), _matrix(model.geom_quat[geom])
            if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH):
                middle = np.array(model.geom_aabb[geom][:3])
                place = place + R @ middle
                number = len(link.findall("collision"))
                self.hulls[f"{link.get('name')}_{number}"] = vertices(model, geom) - middle
            collision = ET.SubElement(link, "collision")
            _place(collision, place - anchor, R)
            ET.SubElement(collision, "geometry").append(shape)


def _matrix(quaternion: Any) -> FloatArray:  # noqa: ANN401
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(quaternion))
    return R.reshape(3, 3)


def _place(element: ET.Element, place: FloatArray, R: FloatArray) -> None:
    ET.SubElement(element, "origin", xyz=numbers(place), rpy=numbers(rpy_of(R)))


def shape_of(model: Any, geom: int) -> ET.Element | None:  # noqa: ANN401
    """Return a geom as a shape of a URDF, a mesh as the box around it; None of a plane and such."""
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    kinds = mujoco.mjtGeom
    if kind == int(kinds.mjGEOM_SPHERE):
        return ET.Element("sphere", radius=repr(float(size[0])))
    if kind == int(kinds.mjGEOM_CAPSULE):  # as a cylinder that is rounded off at its ends
        length = repr(float(2 * (size[1] + size[0])))
        return ET.Element("cylinder", radius=repr(float(size[0])), length=length)
    if kind == int(kinds.mjGEOM_CYLINDER):
        return ET.Element("cylinder", radius=repr(float(size[0])), length=repr(float(2 * size[1])))
    if kind == int(kinds.mjGEOM_BOX):
        return ET.Element("box", size=numbers(2 * size))
    if kind in {int(kinds.mjGEOM_MESH), int(kinds.mjGEOM_ELLIPSOID)}:
        return ET.Element("box", size=numbers(2 * np.array(model.geom_aabb[geom][3:])))
    return None


def vertices(model: Any, geom: int) -> FloatArray:  # noqa: ANN401
    """Return the vertices of a mesh in the frame of its geom, (K, 3) [m]."""
    mesh = int(model.geom_dataid[geom])
    first, many = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    return np.array(model.mesh_vert[first : first + many], dtype=np.float64)
