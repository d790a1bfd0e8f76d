"""MJCF as MuJoCo compiles it, written as the URDF of one arm.

Defaults, classes, includes, meshes without inertia and angles in degrees are so what MuJoCo makes
of them. The frame of a link is that of its body, moved to the joint's anchor.
"""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from limo_driver.descriptions.description import (
    SITE,
    JointDynamics,
    RobotDescription,
    StatedBristles,
    StatedRipple,
    StatedServo,
)
from limo_driver.descriptions.geometry import numbers, rpy_of, turned
from limo_driver.descriptions.xml_text import read_xml
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from limo_driver.types import FloatArray

HINGE, SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_TURNING: Final = {HINGE: "revolute", SLIDE: "prismatic"}
_ROOM: Final = 1.0  # [m] to either side of a joint that slides, where no range is stated
_FEWEST: Final = 2  # arms, of which one has to be chosen
_POLYNOMIAL: Final = 5  # coefficients of an equality of joints
_PAIR: Final = 2  # joints of a body, of which one may be the play of the other
_WIDEST_PLAY: Final = 0.2  # [rad], as the effect has it
_ALIKE: Final = 1e-9  # of axes and their places [m]
# By element: a mass that is no number, MuJoCo replaces by one of a density, and hands others on.
_FINITE: Final = {
    "inertial": ("mass", "pos", "quat", "diaginertia", "fullinertia"),
    "geom": ("mass", "density"),
    "joint": ("damping", "armature", "frictionloss", "stiffness", "springref"),
}


def read_mjcf(path: Path) -> RobotDescription:
    """Read the arm of an MJCF file: of its trees of bodies, the one with the most hinges.

    Raises:
        ConfigError: MuJoCo cannot compile it, it includes files from elsewhere, a mass or the
            like is no finite number, its arm floats, or several trees could be the arm.
    """
    _check_numbers(check_includes(path))
    model = compile_mjcf(path)
    root = _arm(model, path)
    writer = _Writer(model, root)
    writer.write(root)
    coupled = writer.couple()
    return RobotDescription(
        writer.robot,
        path,
        "MJCF",
        writer.dynamics,
        tuple(np.array(model.opt.gravity).tolist()),  # type: ignore[arg-type]  # three
        writer.shifts,
        writer.hulls,
        tuple(_left_aside(model, root, coupled) + writer.notes),
        _servos(model),
        writer.plays,
        places={
            _joint_name(model, j): (int(model.jnt_qposadr[j]), int(model.jnt_dofadr[j]))
            for j in range(model.njnt)
        },
        widths=(int(model.nq), int(model.nv)),
    )


def compile_mjcf(path: Path) -> Any:  # noqa: ANN401  # a MuJoCo model
    """Compile an MJCF file.

    Raises:
        ConfigError: It cannot be; in one line.
    """
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise ConfigError(f"MuJoCo cannot compile it: {reason}", path=path) from None


def check_includes(path: Path) -> tuple[Path, ...]:
    """Return the files that an MJCF file is made of, itself first.

    Raises:
        ConfigError: One lies outside the folder of the first, or declares entities.
    """
    folder = path.resolve().parent
    found, waiting = [path], [path]
    while waiting:
        current = waiting.pop()
        for element in read_xml(current).iter("include"):
            file = folder / str(element.get("file"))
            if not file.resolve().is_relative_to(folder):
                raise ConfigError(
                    f"includes {element.get('file')}, which is outside its folder", path=current
                )
            if not file.is_file():
                raise ConfigError(f"includes {element.get('file')}, which is not there", path=path)
            if file not in found:
                found.append(file)
                waiting.append(file)
    return tuple(found)


def _check_numbers(files: Iterable[Path]) -> None:
    """Refuse masses, inertias and physics of joints that are not finite, by the element's name."""
    for path in files:
        for parent in read_xml(path).iter():
            for element in parent:
                for key in _FINITE.get(element.tag, ()):
                    _check_finite(element, key, parent, path)


def _check_finite(element: ET.Element, key: str, parent: ET.Element, path: Path) -> None:
    for word in element.get(key, "").split():
        try:
            value = float(word)
        except ValueError:
            continue  # MuJoCo says so
        if not np.isfinite(value):
            place = " ".join(filter(None, (parent.tag, parent.get("name") or parent.get("class"))))
            raise ConfigError(
                f"{place}: {key} of its {element.tag} is {word}, expected a finite number",
                path=path,
            )


def _arm(model: Any, path: Path) -> int:  # noqa: ANN401
    """Return the body at the root of the tree that is the arm."""
    count: dict[int, int] = {}
    for joint in range(model.njnt):
        root = int(model.body_rootid[model.jnt_bodyid[joint]])
        count.setdefault(root, 0)
        count[root] += int(model.jnt_type[joint]) == HINGE
    hinges = max(count.values(), default=0)
    if not hinges:
        raise ConfigError("has no hinge joint", path=path)
    arms = [root for root, many in count.items() if many == hinges]
    names = ", ".join(_body_name(model, root) for root in arms)
    if len(arms) >= _FEWEST:
        raise ConfigError(
            f"holds several arms of {hinges} hinges, {names}; expected one in a file", path=path
        )
    free = [
        j
        for j in range(model.njnt)
        if int(model.body_rootid[model.jnt_bodyid[j]]) == arms[0]
        and int(model.jnt_type[j]) not in _TURNING
    ]
    if free:
        kind = "ball" if model.jnt_type[free[0]] == mujoco.mjtJoint.mjJNT_BALL else "free"
        raise ConfigError(
            f"{names} has the {kind} joint {_joint_name(model, free[0])}; limo's arms stand on a "
            "fixed base, with one axis a joint",
            path=path,
        )
    return arms[0]


def _left_aside(model: Any, root: int, coupled: int) -> list[str]:  # noqa: ANN401
    """Say what the file holds that is not represented; so many equalities are."""
    notes: list[str] = []
    others = {int(model.body_rootid[b]) for b in range(1, model.nbody)} - {root}
    if others:
        notes.append(f"left aside: {', '.join(_body_name(model, b) for b in sorted(others))}")
    if left := model.neq - coupled:
        notes.append(f"not represented: {left} equality constraint{'s' * (left > 1)}")
    if model.ntendon:
        notes.append(f"not represented: {model.ntendon} tendons")
    for values, what in (
        (model.dof_dampingpoly[:, 1:], "damping of higher powers of the speed"),
        (
            model.jnt_stiffnesspoly[:, [0, *range(2, model.jnt_stiffnesspoly.shape[1])]],
            "springs other than linear and cubic",
        ),
        (model.body_gravcomp, "gravity compensation"),
    ):
        if np.any(values):
            notes.append(f"not represented: {what}")
    if np.any(model.actuator_armature) or np.any(model.actuator_damping):
        notes.append("not represented: armature and damping of actuators")
    moving = [
        u
        for u in range(_actuators(model))
        if int(model.actuator_dyntype[u]) != 0 and not is_passive_motor(model, u)
    ]
    if moving:
        notes.append(f"not represented: the dynamics of {len(moving)} actuators")
    if np.any(model.actuator_delay):
        notes.append("not represented: delays of actuators")
    return notes


def _body_name(model: Any, body: int) -> str:  # noqa: ANN401
    return model.body(body).name or f"body_{body}"


def _joint_name(model: Any, joint: int) -> str:  # noqa: ANN401
    return model.joint(joint).name or f"joint_{joint}"


class _Writer:
    """Writes one tree of bodies as links and joints."""

    def __init__(self, model: Any, root: int) -> None:  # noqa: ANN401
        self.model = model
        self.robot = ET.Element("robot", name=Path(_body_name(model, root)).stem)
        self.dynamics: dict[str, JointDynamics] = {}
        self.shifts: dict[str, FloatArray] = {}
        self.hulls: dict[str, FloatArray] = {}
        self.notes: list[str] = []
        self.plays: dict[str, str] = {}  # joint → the hinge that is its play
        ET.SubElement(self.robot, "link", name="world")

    def write(self, body: int) -> None:
        """Write a body with its joint, its inertia and shapes, and all bodies that it carries."""
        name, joints = _body_name(self.model, body), self._joints(body)
        play = play_of(self.model, joints)
        if play is not None:
            joints.remove(play)
        if len(joints) > 1:
            named = ", ".join(_joint_name(self.model, j) for j in joints)
            raise ConfigError(f"body {name} has {len(joints)} joints, {named}; expected one a body")
        joint = joints[0] if joints else None
        anchor = np.zeros(3) if joint is None else np.array(self.model.jnt_pos[joint])
        self.shifts[name] = anchor
        link = ET.SubElement(self.robot, "link", name=name)
        self._inertial(link, body, anchor)
        self._shapes(link, body, anchor)
        self._joint(name, body, joint, anchor)
        if joint is not None and play is not None:
            self._play(joint, play)
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
            follower = written.get(_joint_name(model, first))
            if follower is None or follower.find("mimic") is not None:
                continue
            start = [float(model.qpos0[model.jnt_qposadr[j]]) for j in (first, second)]
            ET.SubElement(
                follower,
                "mimic",
                joint=_joint_name(model, second),
                multiplier=repr(ratio),
                offset=repr(offset + start[0] - ratio * start[1]),
            )
            coupled += 1
        return coupled

    def _joints(self, body: int) -> list[int]:
        first, many = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        return list(range(first, first + many))

    def _parent(self, body: int) -> tuple[str, FloatArray]:
        parent = int(self.model.body_parentid[body])
        if not parent:
            return "world", np.zeros(3)
        name = _body_name(self.model, parent)
        return name, self.shifts[name]

    def _joint(self, name: str, body: int, joint: int | None, anchor: FloatArray) -> None:
        model = self.model
        parent, shift = self._parent(body)
        rotation = _matrix(model.body_quat[body])
        place = np.array(model.body_pos[body]) + rotation @ anchor - shift
        if joint is None:
            self._fixed(f"{name}_mount", parent, name, place, rotation)
            return
        kind, axis = int(model.jnt_type[joint]), np.array(model.jnt_axis[joint])
        start = float(model.qpos0[model.jnt_qposadr[joint]])
        if kind == HINGE:
            rotation = rotation @ turned(axis, -start)
        else:
            place = place - rotation @ axis * start
        limited = bool(model.jnt_limited[joint])
        said = _TURNING[kind] if limited or kind == SLIDE else "continuous"
        title = _joint_name(model, joint)
        element = ET.SubElement(self.robot, "joint", name=title, type=said)
        _place(element, place, rotation)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=name)
        ET.SubElement(element, "axis", xyz=numbers(axis))
        low, high = model.jnt_range[joint] if limited else (-_ROOM, _ROOM)
        bounds = {"lower": repr(float(low)), "upper": repr(float(high))}
        if kind == SLIDE and not limited:
            self.notes.append(f"joint {title} states no range; {_ROOM:g} m to either side is taken")
        kept = bounds if said != "continuous" else {}
        effort = repr(_effort(model, joint))
        ET.SubElement(element, "limit", {**kept, "effort": effort, "velocity": "0"})
        self.dynamics[title] = _dynamics(model, joint)

    def _play(self, joint: int, play: int) -> None:
        """Take a second hinge of a body for the backlash of its joint."""
        title, own = _joint_name(self.model, joint), _joint_name(self.model, play)
        low, high = self.model.jnt_range[play].tolist()
        self.plays[title] = own
        self.dynamics[title] = replace(self.dynamics[title], gap=high - low)
        self.notes.append(
            f"joint {own} has no actuator and {high - low:.3g} rad of range: it is the play of "
            f"{title}, about the middle of that range"
        )

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
            shape = _shape(model, geom)
            if shape is None:
                continue
            place, R = np.array(model.geom_pos[geom]), _matrix(model.geom_quat[geom])
            if int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_MESH):
                middle = np.array(model.geom_aabb[geom][:3])
                place = place + R @ middle
                number = len(link.findall("collision"))
                self.hulls[f"{link.get('name')}_{number}"] = _vertices(model, geom) - middle
            collision = ET.SubElement(link, "collision")
            _place(collision, place - anchor, R)
            ET.SubElement(collision, "geometry").append(shape)


def play_of(model: Any, joints: Sequence[int]) -> int | None:  # noqa: ANN401
    """Return which of the two joints of a body is nothing but the play of the other.

    Both are hinges about the same axis; the play has no actuator, and a range that is narrow beside
    that of the other.

    Args:
        model: MuJoCo's model.
        joints: Of one body, by index.
    """
    if len(joints) != _PAIR or any(int(model.jnt_type[j]) != HINGE for j in joints):
        return None
    first, second = (np.array(model.jnt_axis[j]) for j in joints)
    apart = np.ptp(np.array(model.jnt_pos[list(joints)]), axis=0).max()
    if abs(float(first @ second)) < 1.0 - _ALIKE or apart > _ALIKE:
        return None
    moved = {
        int(model.actuator_trnid[u][0])
        for u in range(_actuators(model))
        if int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
    }
    wide = [_width(model, j) for j in joints]
    narrow = int(np.argmin(wide))
    play, other = joints[narrow], 1 - narrow
    is_play = wide[narrow] <= min(_WIDEST_PLAY, wide[other] / _PAIR) and play not in moved
    return play if is_play else None


def _width(model: Any, joint: int) -> float:  # noqa: ANN401
    low, high = model.jnt_range[joint].tolist()
    return high - low if model.jnt_limited[joint] else np.inf


def _shape(model: Any, geom: int) -> ET.Element | None:  # noqa: ANN401
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


def _vertices(model: Any, geom: int) -> FloatArray:  # noqa: ANN401
    """Return the vertices of a mesh in the frame of its geom, (K, 3) [m]."""
    mesh = int(model.geom_dataid[geom])
    first, many = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    return np.array(model.mesh_vert[first : first + many], dtype=np.float64)


def _effort(model: Any, joint: int) -> float:  # noqa: ANN401
    """Return the torque that joint and actuators can have [N m]; 0 where nothing is stated."""
    if model.jnt_actfrclimited[joint]:
        return float(np.abs(model.jnt_actfrcrange[joint]).max())
    total = 0.0
    for u in range(_actuators(model)):
        of_joint = int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not of_joint or int(model.actuator_trnid[u][0]) != joint:
            continue
        gear = abs(float(model.actuator_gear[u][0]))
        direct = (
            int(model.actuator_gaintype[u]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            and int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_NONE)
            and int(model.actuator_dyntype[u]) == int(mujoco.mjtDyn.mjDYN_NONE)
        )
        if model.actuator_forcelimited[u]:
            total += gear * float(np.abs(model.actuator_forcerange[u]).max())
        elif direct and model.actuator_ctrllimited[u]:
            most = float(np.abs(model.actuator_ctrlrange[u]).max())
            total += gear * abs(float(model.actuator_gainprm[u][0])) * most
    return total


def _servos(model: Any) -> dict[str, StatedServo]:  # noqa: ANN401
    """Return the position actuators that move a joint alone, by the name of that joint."""
    found: dict[str, StatedServo] = {}
    for u in range(_actuators(model)):
        gain, bias = np.array(model.actuator_gainprm[u]), np.array(model.actuator_biasprm[u])
        is_servo = (
            int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
            and int(model.actuator_gaintype[u]) == int(mujoco.mjtGain.mjGAIN_FIXED)
            and int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
            and int(model.actuator_dyntype[u]) == int(mujoco.mjtDyn.mjDYN_NONE)
            and gain[0] > 0
            and bias[1] == -gain[0]
        )
        if not is_servo:
            continue
        gear, joint = float(model.actuator_gear[u][0]), int(model.actuator_trnid[u][0])
        limit = None
        if model.actuator_forcelimited[u]:
            limit = abs(gear) * float(np.abs(model.actuator_forcerange[u]).max())
        elif model.jnt_actfrclimited[joint]:
            limit = float(np.abs(model.jnt_actfrcrange[joint]).max())
        if gear == 1.0:  # else the command is not an angle of the joint
            delay = float(np.ravel(model.actuator_delay[u])[0])
            servo = StatedServo(float(gain[0]), -float(bias[2]), limit, delay)
            found[_joint_name(model, joint)] = servo
    return found


def _dynamics(model: Any, joint: int) -> JointDynamics:  # noqa: ANN401
    dof = int(model.jnt_dofadr[joint])
    return JointDynamics(
        friction=float(model.dof_frictionloss[dof]),
        damping=float(model.dof_damping[dof]),
        armature=float(model.dof_armature[dof]),
        stiffness=float(model.jnt_stiffness[joint]),
        rest=float(model.qpos_spring[model.jnt_qposadr[joint]]),
        cubic=float(model.jnt_stiffnesspoly[joint][1]),
        drag=float(model.dof_dampingpoly[dof][0]),
        **_motors(model, joint),
    )


def is_passive_motor(model: Any, actuator: int) -> bool:  # noqa: ANN401
    """Say whether an actuator is a DC motor without inputs: friction and cogging of its joint."""
    return (
        int(model.actuator_biastype[actuator]) == int(mujoco.mjtBias.mjBIAS_DCMOTOR)
        and int(model.actuator_ctrlnum[actuator]) == 0
    )


def _actuators(model: Any) -> int:  # noqa: ANN401
    return len(model.actuator_trntype)  # `nu` counts their inputs


def _motors(model: Any, joint: int) -> dict[str, Any]:  # noqa: ANN401
    """Return LuGre friction and cogging of the DC motors on a joint."""
    bristles, ripples = list[StatedBristles](), list[StatedRipple]()
    for u in range(_actuators(model)):
        of_joint = (
            int(model.actuator_trntype[u]) == int(mujoco.mjtTrn.mjTRN_JOINT)
            and int(model.actuator_trnid[u][0]) == joint
        )
        is_motor = int(model.actuator_biastype[u]) == int(mujoco.mjtBias.mjBIAS_DCMOTOR)
        if not (of_joint and is_motor and float(model.actuator_gear[u][0]) == 1.0):
            continue
        amplitude, cycles, phase, sliding, breakaway, speed, *_ = model.actuator_biasprm[u].tolist()
        *_, stiffness, damping = model.actuator_dynprm[u].tolist()[:7]
        if stiffness:
            bristles.append(StatedBristles(stiffness, damping, sliding, breakaway, speed))
        if amplitude:
            ripples.append(StatedRipple(amplitude, cycles, phase))
    return {"bristles": tuple(bristles), "ripples": tuple(ripples)}


def _matrix(quaternion: Any) -> FloatArray:  # noqa: ANN401
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.array(quaternion))
    return R.reshape(3, 3)


def _place(element: ET.Element, place: FloatArray, R: FloatArray) -> None:
    ET.SubElement(element, "origin", xyz=numbers(place), rpy=numbers(rpy_of(R)))
