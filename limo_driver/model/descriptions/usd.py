"""Arms in USD: rigid bodies, joints, and what PhysX and Newton keep of them, as a description.

Read are `UsdPhysics` joints, masses and gravity, and what `usd_joints` finds of each joint. Angles
are degrees there, also within other units.
"""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import (
    JointDynamics,
    RobotDescription,
    StatedMotor,
    StatedServo,
)
from limo_driver.model.descriptions.geometry import numbers, rpy_of
from limo_driver.model.descriptions.urdf_checks import check_urdf
from limo_driver.model.descriptions.usd_joints import (
    KINDS,
    axis_of,
    contradictions,
    couple,
    drives_of,
    dynamics_of,
    scale_of,
    stated,
    value_of,
    write_shapes,
)
from limo_driver.runtime.plugins import require_package
from limo_driver.types import FloatArray

_AXES: Final = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
INERTIA: Final = "newton:inertia"  # about the centre of mass, in axes of the body
ORDER: Final = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # of its six numbers
_FAST: Final = 1e5  # [deg/s], above which a limit of speed is none
_STANDARD: Final = 9.81  # [m/s²], where a scene states no gravity

_PLACE: Final = re.compile(r":(\d+):\d+: (.+?)(?: at '| in <|'\s|'$)")  # in what USD says
_ASSET: Final = re.compile(r"@([^@]+)@")


class _Frame(NamedTuple):
    place: FloatArray  # (3,) [m]
    R: FloatArray  # (3, 3)


def open_stage(path: Path) -> Any:  # noqa: ANN401  # a stage of USD
    """Open a USD file.

    Raises:
        MissingPackageError: usd-core is not installed.
        ConfigError: It cannot be opened, is not in metres and kilograms, or has layers outside its
            folder.
    """
    require_package("pxr", f"{path}: reading USD")
    from pxr import Tf, Usd, UsdGeom, UsdPhysics

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise ConfigError(f"cannot be opened as USD: {_reason(error)}", path=path) from None
    if lacking := _lacking(stage):
        raise ConfigError(f"uses {lacking}, which cannot be read", path=path)
    folder = path.resolve().parent
    for layer in stage.GetUsedLayers():
        file = layer.realPath
        if file and not Path(file).resolve().is_relative_to(folder):
            raise ConfigError(f"uses {file}, which is outside its folder", path=path)
    for name, unit in (
        ("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage)),
        ("kilogramsPerUnit", UsdPhysics.GetStageKilogramsPerUnit(stage)),
    ):
        if unit != 1.0:
            raise ConfigError(f"has {name} = {unit:g}, expected 1", path=path)
    return stage


def _reason(error: Exception) -> str:
    """Return why a file cannot be opened, without the library's own places in code."""
    found = _PLACE.search(str(error))
    return "it is damaged, or none" if found is None else f"line {found[1]}: {found[2]}"


def _lacking(stage: Any) -> str:  # noqa: ANN401
    """Return the first file that layers or prims refer to and that cannot be read, if any."""
    for error in stage.GetCompositionErrors():
        if (found := _ASSET.search(str(error))) is not None:
            return found[1]
    return ""


def joints_of(stage: Any, path: Path) -> list[Any]:  # noqa: ANN401
    """Return the prims of joints that are in force.

    Raises:
        ConfigError: Two have the same name.
    """
    from pxr import UsdPhysics

    found = [
        prim
        for prim in stage.Traverse()
        if prim.IsA(UsdPhysics.Joint)
        and UsdPhysics.Joint(prim).GetJointEnabledAttr().Get()
        and not UsdPhysics.Joint(prim).GetExcludeFromArticulationAttr().Get()
    ]
    names = [prim.GetName() for prim in found]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise ConfigError(f"has more than one joint called {', '.join(repeated)}", path=path)
    return found


def bodies_of(stage: Any, path: Path) -> dict[str, Any]:  # noqa: ANN401
    """Return the prims of the bodies that joints connect, by name.

    Raises:
        ConfigError: Two have the same name.
    """
    found: dict[str, Any] = {}
    for joint in joints_of(stage, path):
        for prim in _ends(stage, joint):
            if prim is None:
                continue
            name = prim.GetName()
            if found.setdefault(name, prim) != prim:
                raise ConfigError(f"has more than one body called {name}", path=path)
    return found


def read_usd(path: Path) -> RobotDescription:
    """Read a USD file as a description.

    Raises:
        ConfigError: It cannot be opened, its base floats, a joint has more than one axis, or a body
            lacks mass or inertia.
    """
    from pxr import UsdGeom

    stage = open_stage(path)
    joints, bodies = joints_of(stage, path), bodies_of(stage, path)
    if not bodies:
        raise ConfigError("has no joints of USD physics between bodies", path=path)
    tree = {str(_ends(stage, joint)[1].GetName()): joint for joint in _upward(stage, joints, path)}
    root = ET.Element("robot", name=path.stem)
    ET.SubElement(root, "link", name="world")
    shifts = {name: _frame(tree[name], 1).place if name in tree else np.zeros(3) for name in bodies}
    dynamics: dict[str, JointDynamics] = {}
    notes = list[str]()
    hulls: dict[str, FloatArray] = {}
    for name, prim in bodies.items():
        link = _write_link(root, name, prim, shifts[name], path, is_base=name not in tree)
        hulls |= write_shapes(link, prim, bodies, shifts[name])
    (base, *others) = [name for name in bodies if name not in tree] or [""]
    if others or not base:
        raise ConfigError(
            f"its bodies are no tree: {', '.join([base, *others]) or 'none'} at the root", path=path
        )
    ends = [_ends(stage, joint) for joint in joints]
    if not any(None in pair and bodies[base] in pair for pair in ends):
        raise ConfigError(
            f"its base {base} is fixed to nothing; limo's arms stand on a fixed base, which a "
            "PhysicsFixedJoint to the world makes it",
            path=path,
        )
    pose = UsdGeom.XformCache().GetLocalToWorldTransform(bodies[base]).RemoveScaleShear()
    matrix = np.array(pose, dtype=np.float64)  # of rows
    mount = ET.SubElement(root, "joint", name="world_mount", type="fixed")
    place, R = matrix[3, :3], matrix[:3, :3].T
    ET.SubElement(mount, "origin", xyz=numbers(place), rpy=numbers(rpy_of(R)))
    ET.SubElement(mount, "parent", link="world")
    ET.SubElement(mount, "child", link=base)
    for name, joint in tree.items():
        _write_joint(root, stage, joint, name, shifts)
        dynamics[joint.GetName()] = dynamics_of(joint)
        notes += contradictions(joint)
    check_urdf(root, path)  # that this becomes: its parser prints what it refuses
    notes += couple(root, stage, tree.values())
    drives, more = drives_of(stage, tree.values())
    notes += more
    if not any(link.find("collision") is not None for link in root.findall("link")):
        notes.append("has no collision shapes: motion is planned without, or not at all")
    if any(value_of(joint, "physxJoint:jointFriction") for joint in joints):
        notes.append("not represented: physxJoint:jointFriction, which goes with the load")
    servos = {name: own for name, own in drives.items() if isinstance(own, StatedServo)}
    motors = {name: own for name, own in drives.items() if isinstance(own, StatedMotor)}
    return RobotDescription(
        root, path, "USD", dynamics, _gravity(stage), shifts, hulls, tuple(notes), servos, motors
    )


def _upward(stage: Any, joints: list[Any], path: Path) -> list[Any]:  # noqa: ANN401
    """Return the joints between two bodies, each of which moves one body alone."""
    moved = set[str]()
    found = list[Any]()
    for joint in joints:
        parent, child = _ends(stage, joint)
        if joint.GetTypeName() not in KINDS:
            raise ConfigError(
                f"joint {joint.GetName()} is a {joint.GetTypeName()}; limo's joints have one axis",
                path=path,
            )
        if parent is None or child is None:
            continue
        if child.GetName() in moved:
            raise ConfigError(
                f"body {child.GetName()} is moved by two joints; expected a tree", path=path
            )
        moved.add(child.GetName())
        found.append(joint)
    return found


def _ends(stage: Any, joint: Any) -> tuple[Any, Any]:  # noqa: ANN401
    from pxr import UsdPhysics

    of = UsdPhysics.Joint(joint)
    targets = [of.GetBody0Rel().GetTargets(), of.GetBody1Rel().GetTargets()]
    first, second = (stage.GetPrimAtPath(each[0]) if each else None for each in targets)
    return first, second


def _frame(joint: Any, end: int) -> _Frame:  # noqa: ANN401
    from pxr import UsdPhysics

    of = UsdPhysics.Joint(joint)
    place = (of.GetLocalPos0Attr() if end == 0 else of.GetLocalPos1Attr()).Get()
    turned = (of.GetLocalRot0Attr() if end == 0 else of.GetLocalRot1Attr()).Get()
    return _Frame(np.array(place, dtype=np.float64), _matrix(turned))


def _matrix(quaternion: Any) -> FloatArray:  # noqa: ANN401
    from scipy.spatial.transform import Rotation

    xyzw = [*quaternion.GetImaginary(), quaternion.GetReal()]
    return np.asarray(Rotation.from_quat(xyzw).as_matrix())


def _write_link(
    root: ET.Element,
    name: str,
    prim: Any,  # noqa: ANN401
    shift: FloatArray,
    path: Path,
    *,
    is_base: bool,
) -> ET.Element:
    from pxr import UsdPhysics

    link = ET.SubElement(root, "link", name=name)
    stated = UsdPhysics.MassAPI(prim)
    mass = float(stated.GetMassAttr().Get() or 0.0)
    com, moments = stated.GetCenterOfMassAttr().Get(), stated.GetDiagonalInertiaAttr().Get()
    tensor = _tensor(moments, stated.GetPrincipalAxesAttr().Get(), prim)
    known = tensor is not None and np.isfinite(tensor).all() and np.isfinite(com).all()
    if tensor is None or not (known and 0 < mass < math.inf):
        if is_base:
            return link
        raise ConfigError(
            f"body {name} states no mass, centerOfMass and diagonalInertia of its own; limo does "
            "not take them from shapes",
            path=path,
        )
    element = ET.SubElement(link, "inertial")
    place = np.array(com, dtype=np.float64) - shift
    ET.SubElement(element, "origin", xyz=numbers(place), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(mass))
    keys, entries = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), tensor[np.triu_indices(3)].tolist()
    ET.SubElement(element, "inertia", dict(zip(keys, map(repr, entries), strict=True)))
    return link


def _tensor(moments: Any, turned: Any, prim: Any) -> FloatArray | None:  # noqa: ANN401
    """Return the inertia of a body about its centre of mass, (3, 3) [kg m²]; None if not stated."""
    if moments is not None and np.min(moments) > 0:
        R = _matrix(turned) if turned.GetLength() else np.eye(3)
        return np.asarray(R @ np.diag(np.array(moments, dtype=np.float64)) @ R.T)
    six = prim.GetAttribute(INERTIA)
    if not six or not six.HasAuthoredValue() or len(six.Get()) != len(ORDER):
        return None
    tensor = np.zeros((3, 3))
    for (i, j), value in zip(ORDER, six.Get(), strict=True):
        tensor[i, j] = tensor[j, i] = value
    return tensor


def _write_joint(
    root: ET.Element,
    stage: Any,  # noqa: ANN401
    joint: Any,  # noqa: ANN401
    name: str,
    shifts: dict[str, FloatArray],
) -> None:
    parent = str(_ends(stage, joint)[0].GetName())
    first, second = _frame(joint, 0), _frame(joint, 1)
    kind = KINDS[joint.GetTypeName()]
    axis = second.R @ np.array(_AXES[str(joint.GetAttribute("physics:axis").Get() or "X")])
    low, high = (
        float(value_of(joint, f"physics:{which}Limit", default) / scale_of(joint))
        for which, default in (("lower", -math.inf), ("upper", math.inf))
    )
    if kind == "revolute" and not (math.isfinite(low) and math.isfinite(high)):
        kind = "continuous"
    element = ET.SubElement(root, "joint", name=joint.GetName(), type=kind)
    place = first.place - shifts[parent]
    ET.SubElement(element, "origin", xyz=numbers(place), rpy=numbers(rpy_of(first.R @ second.R.T)))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=name)
    if kind == "fixed":
        return
    ET.SubElement(element, "axis", xyz=numbers(axis))
    bounds = {} if kind == "continuous" else {"lower": repr(low), "upper": repr(high)}
    speed = stated(joint, "maxJointVelocity", 1e6)
    drive = value_of(joint, f"drive:{axis_of(joint)}:physics:maxForce", math.inf)
    ET.SubElement(
        element,
        "limit",
        bounds
        | {
            "effort": repr(drive if math.isfinite(drive) else 0.0),
            "velocity": repr(speed / scale_of(joint) if speed < _FAST else 0.0),
        },
    )


def _gravity(stage: Any) -> tuple[float, float, float]:  # noqa: ANN401
    """Return the gravity of the scene, or what USD says is meant without one."""
    from pxr import UsdGeom, UsdPhysics

    down = np.array([0.0, -1.0, 0.0] if UsdGeom.GetStageUpAxis(stage) == "Y" else [0.0, 0.0, -1.0])
    size = _STANDARD
    for prim in stage.Traverse():
        if prim.IsA(UsdPhysics.Scene):
            scene = UsdPhysics.Scene(prim)
            stated = np.array(scene.GetGravityDirectionAttr().Get(), dtype=np.float64)
            down = stated / np.linalg.norm(stated) if stated.any() else down
            magnitude = float(scene.GetGravityMagnitudeAttr().Get())
            size = magnitude if math.isfinite(magnitude) and magnitude >= 0 else size
    x, y, z = (size * down).tolist()
    return x, y, z
