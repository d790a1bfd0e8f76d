"""What USD has of a joint but its place: friction, drive, and which joint it follows.

PhysX, and Newton with Isaac Lab 3, each have words of their own for armature, friction, damping and
speed; where a joint has both, those of PhysX count. A drive is one of `UsdPhysics`, or a
`NewtonActuator`, a prim of its own. Angles are degrees, but in those actuators, which have radians.

Collision shapes of USD as those of a URDF: simple ones exactly, meshes as boxes with corners.
"""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.model.descriptions.description import JointDynamics, StatedMotor, StatedServo
from limo_driver.model.descriptions.geometry import numbers, rpy_of
from limo_driver.types import FloatArray

DEGREES: Final = 180.0 / math.pi  # [deg/rad]
KINDS: Final = {
    "PhysicsRevoluteJoint": "revolute",
    "PhysicsPrismaticJoint": "prismatic",
    "PhysicsFixedJoint": "fixed",
}
ACTUATOR: Final = "NewtonActuator"
TARGETS: Final = "newton:targets"
RATE: Final = 1000.0  # [Hz], of Newton's steps where a scene states none
_RATES: Final = ("newton:timeStepsPerSecond", "physxScene:timeStepsPerSecond")
NEWTON: Final = {  # by what PhysX calls it
    "armature": "newton:armature",
    "dynamicFrictionEffort": "newton:friction",
    "viscousFrictionCoefficient": "newton:damping",
    "maxJointVelocity": "newton:velocityLimit",
}
PD: Final = "NewtonPDControlAPI"
LIMIT: Final = "NewtonMaxEffortClampingAPI"
MOTOR: Final = "NewtonDCMotorClampingAPI"
DELAY: Final = "NewtonActuatorDelayAPI"
_LIMITS: Final = {LIMIT: "newton:maxEffort", MOTOR: "newton:maxMotorEffort"}
_READ: Final = {PD, LIMIT, DELAY}
_MIMIC: Final = re.compile(r"(physxMimicJoint:\w+):referenceJoint")
_APART: Final = 1e-6  # relative, from which on two words say two things: floats have 32 bits


def axis_of(joint: Any) -> str:  # noqa: ANN401
    """Return the instance under which PhysX keeps the axis of a joint."""
    return "linear" if KINDS.get(joint.GetTypeName()) == "prismatic" else "angular"


def scale_of(joint: Any) -> float:  # noqa: ANN401
    """Return how many units of a joint in USD one of limo's is: degrees, or metres."""
    return 1.0 if axis_of(joint) == "linear" else DEGREES


def value_of(prim: Any, name: str, default: float = 0.0) -> float:  # noqa: ANN401
    """Return a number that a prim has; the default where it has none."""
    found = prim.GetAttribute(name)
    value = found.Get() if found else None
    return default if value is None else float(value)


def in_physx(joint: Any, name: str) -> float | None:  # noqa: ANN401
    """Return what PhysX keeps of the axis of a joint, or else of the joint; None if nothing."""
    for place in (f"physxJointAxis:{axis_of(joint)}:{name}", f"physxJoint:{name}"):
        if (found := joint.GetAttribute(place)) and found.HasAuthoredValue():
            return float(found.Get())
    return None


def in_newton(joint: Any, name: str) -> float | None:  # noqa: ANN401
    """Return what Newton keeps of a joint, by the name that PhysX has for it; None if nothing."""
    found = joint.GetAttribute(NEWTON[name])
    return float(found.Get()) if found and found.HasAuthoredValue() else None


def stated(joint: Any, name: str, default: float = 0.0) -> float:  # noqa: ANN401
    """Return what is stated of a joint, by the name that PhysX has for it."""
    for value in (in_physx(joint, name), in_newton(joint, name)):
        if value is not None:
            return value
    return default


def dynamics_of(joint: Any) -> JointDynamics:  # noqa: ANN401
    """Return friction, damping and armature of a joint."""
    return JointDynamics(
        friction=stated(joint, "dynamicFrictionEffort"),
        damping=stated(joint, "viscousFrictionCoefficient") * scale_of(joint),
        armature=stated(joint, "armature"),
    )


def contradictions(joint: Any) -> list[str]:  # noqa: ANN401
    """Return a line for each number that the words of PhysX and of Newton say differently."""
    pairs = ((name, in_physx(joint, name), in_newton(joint, name)) for name in NEWTON)
    return [
        f"joint {joint.GetName()} has {name} = {one:g} in PhysX's words, which counts, and "
        f"{NEWTON[name]} = {other:g}"
        for name, one, other in pairs
        if one is not None
        and other is not None
        and not math.isclose(one, other, rel_tol=_APART, abs_tol=1e-12)
    ]


def rate_of_steps(stage: Any) -> float | None:  # noqa: ANN401
    """Return the rate of a scene's steps, of which delays count [Hz]; None if it states none."""
    for name in _RATES:
        for prim in stage.Traverse():
            if (found := prim.GetAttribute(name)) and found.HasAuthoredValue():
                return float(found.Get())
    return None


def actuators_of(stage: Any) -> list[Any]:  # noqa: ANN401
    """Return the prims of Newton's actuators that are in force."""
    return [prim for prim in stage.Traverse() if prim.GetTypeName() == ACTUATOR]


def targets_of(actuator: Any) -> list[Any]:  # noqa: ANN401
    """Return the paths of the joints that an actuator moves."""
    found = actuator.GetRelationship(TARGETS)
    return list(found.GetTargets()) if found else []


def drives_of(stage: Any, joints: Iterable[Any]) -> tuple[dict[str, Any], list[str]]:  # noqa: ANN401
    """Return servos and motors of joints by name, and what of them could not be represented."""
    moved = {path: prim for prim in actuators_of(stage) for path in targets_of(prim)}
    rate = rate_of_steps(stage) or RATE
    found, notes = dict[str, Any](), list[str]()
    for joint in joints:
        actuator, servo = moved.get(joint.GetPath()), _servo(joint)
        if actuator is not None:
            schemas = schemas_of(actuator)
            servo = _of_actuator(actuator, schemas, rate)
            if left := sorted(schemas - _READ):
                notes.append(f"not represented: {', '.join(left)} of {actuator.GetName()}")
        if servo is not None:
            found[joint.GetName()] = servo
    return found, notes


def schemas_of(prim: Any) -> set[str]:  # noqa: ANN401
    """Return the schemas applied to a prim, whether or not USD knows them."""
    from pxr import Sdf

    stated = Sdf.TokenListOp()
    for spec in reversed(prim.GetPrimStack()):
        own = spec.GetInfo("apiSchemas")
        items = own.ApplyOperations(list(stated.explicitItems))
        stated = Sdf.TokenListOp.CreateExplicit(items)
    return set(stated.explicitItems)


def _of_actuator(prim: Any, schemas: set[str], rate: float) -> StatedServo | StatedMotor | None:  # noqa: ANN401
    """Return what an actuator is: a servo of position or velocity, or of torque."""
    if PD not in schemas:
        return None
    kp, kd = value_of(prim, "newton:kp"), value_of(prim, "newton:kd")
    limits = [value_of(prim, name, math.inf) for key, name in _LIMITS.items() if key in schemas]
    limit = min(limits, default=math.inf)
    most = limit if math.isfinite(limit) else None
    delay = value_of(prim, "newton:delaySteps") / rate if DELAY in schemas else 0.0
    return StatedServo(kp, kd, most, delay) if kp or kd else StatedMotor(1.0, most, delay)


def _servo(joint: Any) -> StatedServo | None:  # noqa: ANN401
    drive = f"drive:{axis_of(joint)}:physics"
    kp, kd = (value_of(joint, f"{drive}:{name}") for name in ("stiffness", "damping"))
    kind = joint.GetAttribute(f"{drive}:type")
    if not kp or (kind and kind.Get() == "acceleration"):
        return None
    limit = value_of(joint, f"{drive}:maxForce", math.inf)
    scale = scale_of(joint)
    return StatedServo(kp * scale, kd * scale, limit if math.isfinite(limit) else None)


def couple(root: ET.Element, stage: Any, joints: Iterable[Any]) -> list[str]:  # noqa: ANN401
    """Let joints follow those that they mimic.

    Returns:
        What could not be represented.
    """
    notes, written = list[str](), {str(x.get("name")): x for x in root.findall("joint")}
    for joint in joints:
        for targets, ratio, offset in _mimicked(joint):
            leader = stage.GetPrimAtPath(targets[0]) if len(targets) == 1 else None
            if not leader or axis_of(leader) != axis_of(joint) or leader.GetName() not in written:
                notes.append(f"not represented: which joint {joint.GetName()} mimics")
                continue
            law = {"multiplier": repr(ratio), "offset": repr(offset / scale_of(joint))}
            ET.SubElement(written[joint.GetName()], "mimic", {"joint": leader.GetName(), **law})
    return notes


def _mimicked(joint: Any) -> list[tuple[list[Any], float, float]]:  # noqa: ANN401
    """Return whom a joint follows, q = ratio q_leader + offset, with both; PhysX's words count."""
    own = [
        (relation.GetTargets(), found[1])
        for relation in joint.GetRelationships()
        if (found := _MIMIC.fullmatch(relation.GetName())) is not None
    ]
    if own:  # q + gearing q_leader + offset = 0
        return [
            (targets, -value_of(joint, f"{at}:gearing"), -value_of(joint, f"{at}:offset"))
            for targets, at in own
        ]
    targets = joint.GetRelationship("newton:mimicJoint").GetTargets()
    if not targets or not value_of(joint, "newton:mimicEnabled", 1.0):
        return []
    ratio = value_of(joint, "newton:mimicCoef1", 1.0)
    return [(targets, ratio, value_of(joint, "newton:mimicCoef0"))]


# From the axis along which a shape lies to z, along which it lies in a URDF.
_ALONG: Final = {
    "X": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}
_FEWEST: Final = 4  # corners of a body


def write_shapes(
    link: ET.Element,
    prim: Any,  # noqa: ANN401
    bodies: Mapping[str, Any],
    shift: FloatArray,
) -> dict[str, FloatArray]:
    """Write the collision shapes of a body into its link.

    Args:
        link: To be added to.
        prim: The body.
        bodies: All bodies of the arm by name, whose shapes are not those of their parents.
        shift: From the frame of the body to that of the link, (3,) [m].

    Returns:
        Corners of each mesh in the frame of the box that stands for it, (K, 3) [m], by name of the
        link and number of the shape on it.
    """
    hulls: dict[str, FloatArray] = {}
    for shape, to_body in _shapes_of(prim, {body.GetPath() for body in bodies.values()}):
        found = _simple(shape, to_body)
        if found is None and (corners := _corners(shape, to_body)) is not None:
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            hulls[f"{link.get('name')}_{len(link.findall('collision'))}"] = corners - middle
            found = ET.Element("box", size=numbers(np.ptp(corners, axis=0))), middle, np.eye(3)
        if found is None:
            continue
        element, place, R = found
        collision = ET.SubElement(link, "collision")
        ET.SubElement(collision, "origin", xyz=numbers(place - shift), rpy=numbers(rpy_of(R)))
        ET.SubElement(collision, "geometry").append(element)
    return hulls


def _shapes_of(prim: Any, bodies: set[Any]) -> Iterator[tuple[Any, FloatArray]]:  # noqa: ANN401
    """Yield the shapes of a body that collide, and (4, 4) from each to the body, of rows."""
    from pxr import Usd, UsdGeom, UsdPhysics

    cache = UsdGeom.XformCache()
    to_body = cache.GetLocalToWorldTransform(prim).RemoveScaleShear().GetInverse()
    walk = iter(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))
    colliding: list[Any] = []  # paths at or below which shapes collide
    for item in walk:
        path = item.GetPath()
        if path != prim.GetPath() and path in bodies:
            walk.PruneChildren()
            continue
        if item.HasAPI(UsdPhysics.CollisionAPI):
            colliding.append(path)
        if item.IsA(UsdGeom.Gprim) and any(path.HasPrefix(above) for above in colliding):
            yield item, np.array(cache.GetLocalToWorldTransform(item) * to_body, dtype=np.float64)


def _simple(
    shape: Any,  # noqa: ANN401
    to_body: FloatArray,
) -> tuple[ET.Element, FloatArray, FloatArray] | None:
    """Return a shape that a URDF has, its place [m] and rotation; None if it has none such."""
    from pxr import UsdGeom

    A = to_body[:3, :3].T
    scale = np.linalg.norm(A, axis=0)
    mirrored = np.linalg.det(A) < 0  # each of these shapes is its own mirror image
    R = A / scale * np.array([1.0, 1.0, -1.0 if mirrored else 1.0])
    place, largest = to_body[3, :3], float(scale.max())
    if shape.IsA(UsdGeom.Sphere):
        radius = largest * float(UsdGeom.Sphere(shape).GetRadiusAttr().Get())
        return ET.Element("sphere", radius=repr(radius)), place, R
    if shape.IsA(UsdGeom.Cube):
        size = scale * float(UsdGeom.Cube(shape).GetSizeAttr().Get())
        return ET.Element("box", size=numbers(size)), place, R
    for kind in (UsdGeom.Capsule, UsdGeom.Cylinder):
        if shape.IsA(kind):
            own = kind(shape)
            radius = largest * float(own.GetRadiusAttr().Get())
            axis = str(own.GetAxisAttr().Get())
            length = float(own.GetHeightAttr().Get()) * float(scale["XYZ".index(axis)])
            if kind is UsdGeom.Capsule:  # as a cylinder that is rounded off at its ends
                length += 2 * radius
            element = ET.Element("cylinder", radius=repr(radius), length=repr(length))
            return element, place, R @ _ALONG[axis]
    return None


def _corners(shape: Any, to_body: FloatArray) -> FloatArray | None:  # noqa: ANN401
    """Return the corners of a mesh in the frame of its body, (K, 3) [m]; None of what is none."""
    from pxr import UsdGeom

    if not shape.IsA(UsdGeom.Mesh):
        return None
    points = np.array(UsdGeom.Mesh(shape).GetPointsAttr().Get() or (), dtype=np.float64)
    if len(points) < _FEWEST or not np.isfinite(points).all():
        return None
    return points @ to_body[:3, :3] + to_body[3, :3]
