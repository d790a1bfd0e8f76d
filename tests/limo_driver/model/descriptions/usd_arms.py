"""A URDF arm as a USD asset, with frames of joints that are turned and shifted at random."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from limo_driver.model.descriptions.geometry import rotation_of


def usd_of(model, path, seed=0, held=True, up="Z"):
    """Write the moving bodies of a description; joints turn about any axis of their frames."""
    from pxr import Usd, UsdGeom, UsdPhysics

    random = np.random.default_rng(seed)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/robot").GetPrim())
    urdf = model.description.root
    joints = [joint for joint in urdf.findall("joint") if joint.get("type") != "fixed"]
    names = dict.fromkeys(_link(joint, end) for joint in joints for end in ("parent", "child"))
    links = {link.get("name"): link for link in urdf.findall("link")}
    for name in names:
        _write_body(stage, name, links[name].find("inertial"))
        for number, shape in enumerate(links[name].findall("collision")):
            _write_shape(stage, f"/robot/{name}/shape_{number}", shape)
    moved = {_link(joint, "child") for joint in joints}
    if held:
        mount = UsdPhysics.FixedJoint.Define(stage, "/robot/root_joint")
        (base,) = set(names) - moved
        mount.CreateBody1Rel().AddTarget(f"/robot/{base}")
    for joint in joints:
        _write_joint(stage, joint, random)
    stage.GetRootLayer().Save()
    return path


def _write_body(stage, name, stated):
    from pxr import Gf, UsdGeom, UsdPhysics

    prim = UsdGeom.Xform.Define(stage, f"/robot/{name}").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    if stated is None:
        return
    inertia, origin = stated.find("inertia").attrib, stated.find("origin")
    entries = [[float(inertia["i" + "".join(sorted(a + b))]) for b in "xyz"] for a in "xyz"]
    R = rotation_of(_vector(origin, "rpy"))
    moments, axes = np.linalg.eigh(R @ np.array(entries) @ R.T)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    mass = UsdPhysics.MassAPI.Apply(prim)
    mass.CreateMassAttr().Set(float(stated.find("mass").get("value")))
    mass.CreateCenterOfMassAttr().Set(Gf.Vec3f(*_vector(origin, "xyz").tolist()))
    mass.CreateDiagonalInertiaAttr().Set(Gf.Vec3f(*moments.tolist()))
    mass.CreatePrincipalAxesAttr().Set(_quaternion(axes))


def _write_shape(stage, path, stated):
    """A cylinder of a URDF, at half its size with a scale of 2, and turned to lie along x."""
    from pxr import Gf, UsdGeom, UsdPhysics

    cylinder, origin = stated.find("geometry/cylinder"), stated.find("origin")
    if cylinder is None:
        return
    made = UsdGeom.Cylinder.Define(stage, path)
    made.CreateAxisAttr().Set("X")
    made.CreateRadiusAttr().Set(0.5 * float(cylinder.get("radius")))
    made.CreateHeightAttr().Set(0.5 * float(cylinder.get("length")))
    to_z = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])  # x to z
    made.AddTranslateOp().Set(Gf.Vec3d(*_vector(origin, "xyz").tolist()))
    made.AddOrientOp().Set(_quaternion(rotation_of(_vector(origin, "rpy")) @ to_z))
    made.AddScaleOp().Set(Gf.Vec3f(2.0))
    UsdPhysics.CollisionAPI.Apply(made.GetPrim())


def _write_joint(stage, joint, random):
    from pxr import Gf, Sdf, UsdPhysics

    slides = joint.get("type") == "prismatic"
    kind = UsdPhysics.PrismaticJoint if slides else UsdPhysics.RevoluteJoint
    made = kind.Define(stage, f"/robot/turns_{joint.get('name')}")
    made.CreateBody0Rel().AddTarget(f"/robot/{_link(joint, 'parent')}")
    made.CreateBody1Rel().AddTarget(f"/robot/{_link(joint, 'child')}")
    axis, origin = _vector(joint.find("axis"), "xyz", "1 0 0"), joint.find("origin")
    along = random.normal() * 0.05 * axis  # a frame anywhere on the axis
    columns = np.linalg.qr(np.column_stack([axis, random.normal(size=(3, 2))]))[0]
    columns[:, 0] = axis
    columns[:, 2] *= np.sign(np.linalg.det(columns))
    third = int(random.integers(3))
    frame = np.roll(columns, third, axis=1)
    R = rotation_of(_vector(origin, "rpy"))
    made.CreateLocalPos0Attr().Set(Gf.Vec3f(*(_vector(origin, "xyz") + R @ along).tolist()))
    made.CreateLocalRot0Attr().Set(_quaternion(R @ frame))
    made.CreateLocalPos1Attr().Set(Gf.Vec3f(*along.tolist()))
    made.CreateLocalRot1Attr().Set(_quaternion(frame))
    made.CreateAxisAttr().Set("XYZ"[third])
    limit, scale = joint.find("limit"), 1.0 if slides else 180 / np.pi
    made.CreateLowerLimitAttr().Set(float(limit.get("lower")) * scale)
    made.CreateUpperLimitAttr().Set(float(limit.get("upper")) * scale)
    drive = UsdPhysics.DriveAPI.Apply(made.GetPrim(), "linear" if slides else "angular")
    drive.CreateMaxForceAttr().Set(float(limit.get("effort")))
    speed = made.GetPrim().CreateAttribute("physxJoint:maxJointVelocity", Sdf.ValueTypeNames.Float)
    speed.Set(float(limit.get("velocity")) * scale)
    made.GetPrim().CreateAttribute("custom:serial", Sdf.ValueTypeNames.String).Set("kept")


def _vector(element, name, default="0 0 0"):
    text = default if element is None else element.get(name, default)
    return np.array([float(word) for word in text.split()])


def _quaternion(R):
    from pxr import Gf

    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return Gf.Quatf(w, x, y, z)


def _link(joint, end):
    return joint.find(end).get("link")
