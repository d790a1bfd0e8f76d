"""A simulation in USD: a layer over a copy of the user's file, which says only what was found.

The layer has the user's as its sublayer, and attributes over it: masses and inertias, of each joint
the armature, dry and viscous friction in the words of PhysX and in those of Newton, and drives as
Newton's actuators. The file lies beside it as it was, with all that it refers to.
"""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.exports.changes.bodies import parts_of, pseudo_inertia
from limo_driver.exports.changes.origin import TITLE, origin_entries
from limo_driver.exports.newton import Actuators, write_actuators
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.descriptions.usd import INERTIA, ORDER, bodies_of, joints_of, open_stage
from limo_driver.model.descriptions.usd_joints import (
    NEWTON,
    axis_of,
    in_newton,
    in_physx,
    scale_of,
)
from limo_driver.runtime.outputs import require_apart, whole

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.exports.changes.target import Target

_SAME: Final = 1e-7  # relative: attributes are floats of 32 bits
_SAME_BODY: Final = 1e-6  # relative, of second moments that such floats make
_COPIED: Final = ("defaultPrim", "metersPerUnit", "kilogramsPerUnit", "upAxis")


class Layer(NamedTuple):
    """What was written."""

    text: str
    actuators: Actuators  # and their files


def write_layer(target: Target, place: Path) -> Layer:
    """Write a layer over the file of a target.

    Args:
        target: What has to change.
        place: To be written, .usda, in the folder that has a copy of the file.

    Returns:
        Its text, and what else was written.

    Raises:
        ConfigError: It cannot be written, or is the file itself; or a drive needs a network, and
            `onnx` is not installed.
    """
    from pxr import Sdf, Usd

    into = target.model.urdf
    require_apart([place], [into])
    base = open_stage(into)
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for key in _COPIED:
        if base.GetRootLayer().pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, base.GetRootLayer().pseudoRoot.GetInfo(key))
    layer.subLayerPaths.append(str(into.resolve()))
    stage = Usd.Stage.Open(layer)
    joints = {prim.GetName(): prim for prim in joints_of(stage, into)}
    bodies = bodies_of(stage, into)
    for name, body in _inertials(target).items():
        _write_inertial(bodies[name], body)
    names = target.model.joint_names
    now = dict(zip(names, map(_kept, target.split.joints), strict=True))
    for name, wanted in now.items():
        _write_joint(joints[name], wanted)
    actuators = write_actuators(stage, joints, target.simulation, target.model.description, place)
    users = {name: _kept(target.users.get(name, JointDynamics())) for name in names}
    if entries := origin_entries(users, now, {}):
        layer.customLayerData = {TITLE: json.dumps(entries)}
    written = Sdf.Layer.CreateAnonymous(".usda")  # which no stage has open
    written.TransferContent(layer)
    written.subLayerPaths[0] = f"./{into.name}"
    text = written.ExportToString()
    with whole(place) as draft:
        draft.write_text(text, encoding="utf-8")
    return Layer(text, actuators)


def files_of(into: Path) -> list[Path]:
    """Return a USD file and all files that it refers to: layers, textures.

    Raises:
        ConfigError: Its name has characters that no layer can refer to.
    """
    from pxr import Sdf, Tf, UsdUtils

    try:
        Sdf.AssetPath(name := into.name)
    except Tf.ErrorException:  # control characters
        name = "\\"
    if "\\" in name:  # which is taken for a slash
        raise ConfigError(
            "has a line end, a backslash or the like in its name, to which no layer of USD can "
            "refer; rename it",
            path=into,
        )
    layers, assets, _ = UsdUtils.ComputeAllDependencies(str(into))
    found = [into, *(Path(layer.realPath) for layer in layers), *map(Path, assets)]
    return [path for path in dict.fromkeys(item.resolve() for item in found) if path.is_file()]


def _kept(joint: JointDynamics) -> JointDynamics:
    """Return what PhysX and Newton have of a joint."""
    return JointDynamics(friction=joint.friction, damping=joint.damping, armature=joint.armature)


def _inertials(target: Target) -> dict[str, Inertial]:
    """Return the bodies that change; payloads are added to the last one."""
    found = dict(target.inertials)
    parts = {part.name: part for each in parts_of(target.model).values() for part in each}
    for payload in target.split.payloads:
        own = found.get(target.last, parts[target.last].inertial)
        shift = target.model.description.shifts[target.last]
        x, y, z = (np.array(payload.com) + shift).tolist()
        load = Inertial(payload.mass, (x, y, z), payload.inertia)
        found[target.last] = load if own is None else own.joined(load)
    return {
        name: body for name, body in found.items() if not _is_written(parts[name].inertial, body)
    }


def _is_written(stated: Inertial | None, body: Inertial) -> bool:
    """Say whether a body is what the file states, but for its floats of 32 bits."""
    if stated is None:
        return False
    one, other = pseudo_inertia(stated), pseudo_inertia(body)
    size = np.sqrt(np.outer(np.diag(other), np.diag(other)))
    return bool((np.abs(one - other) <= _SAME_BODY * size).all())


def _write_inertial(prim: Any, body: Inertial) -> None:  # noqa: ANN401
    from pxr import Gf, UsdPhysics
    from scipy.spatial.transform import Rotation

    moments, R = np.linalg.eigh(body.tensor())
    R[:, 2] *= np.sign(np.linalg.det(R))
    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    stated = UsdPhysics.MassAPI.Apply(prim)
    stated.CreateMassAttr().Set(body.mass)
    stated.CreateCenterOfMassAttr().Set(Gf.Vec3f(*body.com))
    stated.CreateDiagonalInertiaAttr().Set(Gf.Vec3f(*moments.tolist()))
    stated.CreatePrincipalAxesAttr().Set(Gf.Quatf(w, x, y, z))
    if (six := prim.GetAttribute(INERTIA)) and six.HasAuthoredValue():  # it goes over these two
        six.Set([float(body.tensor()[place]) for place in ORDER])


def _write_joint(prim: Any, wanted: JointDynamics) -> None:  # noqa: ANN401
    """Write what a joint has, in the words of PhysX and of Newton, where either says otherwise."""
    axis, damping = axis_of(prim), wanted.damping / scale_of(prim)
    values = {
        "armature": wanted.armature,
        "dynamicFrictionEffort": wanted.friction,
        "staticFrictionEffort": wanted.friction,
        "viscousFrictionCoefficient": damping,
    }
    physx = {f"physxJointAxis:{axis}:{x}": (in_physx(prim, x), y) for x, y in values.items()}
    newton = {NEWTON[x]: (in_newton(prim, x), y) for x, y in values.items() if x in NEWTON}
    _set_changed(prim, f"PhysxJointAxisAPI:{axis}", physx)
    _set_changed(prim, "NewtonJointAPI", newton)


def _set_changed(prim: Any, schema: str, pairs: Mapping[str, tuple[float | None, float]]) -> None:  # noqa: ANN401
    """Set attributes of a schema that are others than they are, or than 0 where they are not."""
    from pxr import Sdf

    for name, (stated, value) in pairs.items():
        old = stated or 0.0
        if abs(old - value) > _SAME * max(abs(old), abs(value)):
            prim.AddAppliedSchema(schema)
            prim.CreateAttribute(name, Sdf.ValueTypeNames.Float, False).Set(value)
