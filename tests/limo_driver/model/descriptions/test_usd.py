"""Arms in USD need the torque that the same arms need as URDF; what is damaged is refused."""

import numpy as np
import pytest
from lanes import sampled
from usd_arms import usd_of

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel

pytest.importorskip("pxr", reason="needs usd-core: pip install limo[usd]")


@sampled("ending", ["usda", "usdc"], "writes and reads a description each")
@sampled("seed", range(3), "writes and reads a description each")
def test_an_arm_needs_the_torque_that_it_needs_as_urdf(tmp_path, seed, ending):
    urdf = RobotModel.load("iiwa14")
    usd = RobotModel(usd_of(urdf, tmp_path / f"arm.{ending}", seed))
    assert usd.n == urdf.n
    random = np.random.default_rng(seed)
    q, v, a = random.uniform(-1, 1, (3, 50, 7))
    np.testing.assert_allclose(
        usd.inverse_dynamics(q, v, a), urdf.inverse_dynamics(q, v, a), atol=2e-4
    )
    np.testing.assert_allclose(usd.limits.position_max, urdf.limits.position_max, rtol=1e-6)
    np.testing.assert_allclose(usd.limits.torque, urdf.limits.torque)


def test_shapes_are_those_of_the_urdf(tmp_path):
    arm = RobotModel.load("iiwa14")
    read = RobotModel(usd_of(arm, tmp_path / "arm.usda"))
    q = np.linspace(-0.8, 0.9, 7)
    found, expected = _ends(read, q), _ends(arm, q)
    assert len(expected) > 3
    np.testing.assert_allclose(found, expected, atol=2e-5)


def _ends(model, q):
    """Ends of the capsules that move in the base frame, in order, with their radii."""
    poses = model.joint_poses(q)
    found = []
    for c in model.capsules():
        if c.joint >= 0:
            R, p = poses[c.joint][:3, :3], poses[c.joint][:3, 3]
            ends = sorted([tuple((R @ c.start + p).round(5)), tuple((R @ c.end + p).round(5))])
            found.append([*ends[0], *ends[1], c.radius])
    return sorted(found)


def test_meshes_are_planned_with_by_their_corners(tmp_path):
    from pxr import Usd, UsdGeom, UsdPhysics

    path = usd_of(RobotModel.load("iiwa14"), tmp_path / "arm.usda")
    stage = Usd.Stage.Open(str(path))
    group = UsdGeom.Xform.Define(stage, "/robot/link4/collisions")
    group.AddTranslateOp().Set((0.0, 0.0, 0.1))
    UsdPhysics.CollisionAPI.Apply(group.GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/robot/link4/collisions/mesh")
    points = [(0, 0, 0), (0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.3)]
    mesh.CreatePointsAttr().Set(points)
    mesh.AddScaleOp().Set((1.0, 0.5, 1.0))
    stage.GetRootLayer().Save()
    description = RobotModel(path).description
    (corners,) = description.hulls.values()
    np.testing.assert_allclose(np.ptp(corners, axis=0), [0.1, 0.1, 0.3], atol=1e-6)
    (name,) = description.hulls
    link, _, number = name.rpartition("_")
    assert link == "link4"
    box = description.root.find("link[@name='link4']").findall("collision")[int(number)]
    assert box.find("geometry/box") is not None


def test_a_y_up_stage_has_its_gravity_along_y(tmp_path):
    usd = RobotModel(usd_of(RobotModel.load("iiwa14"), tmp_path / "arm.usda", up="Y"))
    np.testing.assert_allclose(usd.gravity, (0, -9.81, 0))


def without_mass(stage, _):
    stage.GetPrimAtPath("/robot/link3").RemoveAPI(_api("MassAPI"))
    for name in ("mass", "centerOfMass", "diagonalInertia", "principalAxes"):
        stage.GetPrimAtPath("/robot/link3").RemoveProperty(f"physics:{name}")


def in_centimetres(stage, _):
    from pxr import UsdGeom

    UsdGeom.SetStageMetersPerUnit(stage, 0.01)


def of_a_ball(stage, _):
    prim = next(p for p in stage.Traverse() if p.GetTypeName() == "PhysicsRevoluteJoint")
    prim.SetTypeName("PhysicsSphericalJoint")


def nowhere(stage, _):
    from pxr import Gf

    joint = next(p for p in stage.Traverse() if p.GetTypeName() == "PhysicsRevoluteJoint")
    joint.GetAttribute("physics:localPos0").Set(Gf.Vec3f(float("nan"), 0.0, 0.0))


def from_elsewhere(stage, folder):
    outside = folder.parent / "outside.usda"
    outside.write_text("#usda 1.0\n", encoding="utf-8")
    stage.GetRootLayer().subLayerPaths.append("../outside.usda")


def _api(name):
    from pxr import UsdPhysics

    return getattr(UsdPhysics, name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (without_mass, "body link3 states no mass, centerOfMass and diagonalInertia"),
        (in_centimetres, "has metersPerUnit = 0.01, expected 1"),
        (of_a_ball, "is a PhysicsSphericalJoint; limo's joints have one axis"),
        (nowhere, "xyz of its origin is"),
        (from_elsewhere, "outside.usda, which is outside its folder"),
    ],
)
def test_what_cannot_be_read_is_refused_in_one_line(tmp_path, capfd, change, said):
    from pxr import Usd

    folder = tmp_path / "own"
    folder.mkdir()
    path = usd_of(RobotModel.load("iiwa14"), folder / "arm.usda")
    stage = Usd.Stage.Open(str(path))
    change(stage, folder)
    stage.GetRootLayer().Save()
    with pytest.raises(ConfigError, match=said) as error:
        RobotModel(path)
    assert "\n" not in str(error.value)
    assert "pxr" not in str(error.value)
    assert not capfd.readouterr().err  # where parsers print what they refuse


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(", "cannot be opened as USD: line 3: Expected"),
        ("(\n  subLayers = [@./nowhere.usda@]\n)", r"uses .*nowhere.usda, which cannot be read"),
        ('def Xform "a" ( references = @./nothing.usda@ ) {}', r"uses .*nothing.usda, which"),
    ],
)
def test_what_usd_says_is_told_without_its_own_code(tmp_path, text, said):
    path = tmp_path / "arm.usda"
    path.write_text(f"#usda 1.0\n{text}\n")
    with pytest.raises(ConfigError, match=said) as error:
        RobotModel(path)
    assert "pxr" not in str(error.value)


def test_a_joint_that_mimics_another_follows_it(tmp_path):
    from pxr import Sdf, Usd

    path = usd_of(RobotModel.load("iiwa14"), tmp_path / "arm.usda")
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath("/robot/turns_joint4")
    for name, value in (("gearing", 0.5), ("offset", -20.0)):
        attribute = prim.CreateAttribute(f"physxMimicJoint:rotX:{name}", Sdf.ValueTypeNames.Float)
        attribute.Set(value)
    rel = prim.CreateRelationship("physxMimicJoint:rotX:referenceJoint")
    rel.AddTarget("/robot/turns_joint2")
    stage.GetRootLayer().Save()
    model = RobotModel.load(path)
    assert model.n == 6
    leader, ratio, offset = model.description.followers["turns_joint4"]
    assert (leader, ratio) == ("turns_joint2", -0.5)
    assert offset == pytest.approx(np.deg2rad(20))


def test_a_floating_base_is_refused(tmp_path):
    path = usd_of(RobotModel.load("iiwa14"), tmp_path / "arm.usda", held=False)
    with pytest.raises(ConfigError, match="is fixed to nothing"):
        RobotModel(path)


@pytest.mark.parametrize("content", [b"", b"#usda 1.0\n(", b"PXR-USDC\x00\x01", b"\x00\xff" * 40])
@sampled("ending", ["usd", "usda", "usdc"], "reads USD in a process of its own each")
def test_damaged_files_are_refused_in_one_line(tmp_path, content, ending):
    path = tmp_path / f"arm.{ending}"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"USD") as error:
        RobotModel(path)
    assert "\n" not in str(error.value)
