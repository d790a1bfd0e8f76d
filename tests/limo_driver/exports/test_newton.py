"""USD as Newton and Isaac Lab 3 read it: words of joints, and actuators, held to their schemas."""

from __future__ import annotations

import importlib.util
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lanes import sampled

from limo_driver.exports.changes.target import target_of
from limo_driver.exports.usd import write_layer
from limo_driver.model import RobotModel
from limo_driver.physics import (
    Armature,
    CoulombFriction,
    Payload,
    PositionServo,
    Simulation,
    TorqueDrive,
    VelocityServo,
    ViscousFriction,
)
from limo_driver.physics.drives import DcMotor

pytest.importorskip("pxr", reason="needs usd-core: pip install limo[usd]")

ARM = Path(__file__).parents[2] / "regression" / "data" / "two_links.usda"
EFFECTS = (
    CoulombFriction(joint=1, tau_c=0.7),
    ViscousFriction(joint=1, f_v=1.5),
    Armature(joint=2, inertia=0.2),
)
DELAYED = PositionServo(joint=1, kp=17.5, kd=0.8, torque_limit=3.0, delay=0.0145)
LIMITED = PositionServo(joint=2, kp=16.0, kd=0.6, torque_limit=5.0)
MOTOR = DcMotor(joint=2, kt=0.1, resistance=1.5, supply=24.0, gear=8.0)
INTEGRAL = PositionServo(joint=1, kp=17.5, kd=0.8, ki=4.0, integral_limit=2.0)
LOOSE = PositionServo(joint=2, kp=16.0, kd=0.6, dead_band=0.01, punch=0.3, torque_limit=5.0)
TURNING = VelocityServo(joint=1, kv=3.5, ki=8.0)
TOLD = TorqueDrive(joint=2, gain=2.0, torque_limit=30.0)
SETS = ((DELAYED, LIMITED, MOTOR), (INTEGRAL, LOOSE), (TURNING, TOLD))


@pytest.fixture
def arm(tmp_path):
    """A file of two joints of one's own, and what is edited in it."""
    path = tmp_path / "own" / "arm.usda"
    path.parent.mkdir()
    shutil.copyfile(ARM, path)
    return path


def edited(path, edit):
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    edit(stage)
    stage.GetRootLayer().Save()


def numbers(prim):
    """The authored attributes in Newton's words."""
    found = prim.GetAuthoredPropertiesInNamespace("newton")
    return {x.GetBaseName(): x.Get() for x in found if x.GetName() != "newton:targets"}


def exported(arm, drives, effects=EFFECTS, name="found"):
    """A layer beside the file: where it is, what was written, and its prims by name."""
    from pxr import Usd

    place = arm.with_name(f"{name}.usda")
    target = target_of(Simulation(str(arm), effects, drives=drives), arm, "usd", 4)
    layer = write_layer(target, place)
    stage = Usd.Stage.Open(str(place))
    return place, layer, lambda name: stage.GetPrimAtPath(f"/robot/{name}")


def schemas(prim):
    return prim.GetPrimStack()[0].GetInfo("apiSchemas").explicitItems


def test_joints_have_the_words_of_newton_beside_those_of_physx(arm):
    _, found, at = exported(arm, ())
    assert numbers(at("turns_a")) == pytest.approx({"damping": np.deg2rad(1.5), "friction": 0.7})
    assert numbers(at("turns_b")) == pytest.approx({"armature": 0.2})
    axis = "physxJointAxis:angular"
    assert at("turns_b").GetAttribute(f"{axis}:armature").Get() == pytest.approx(0.2)
    assert found.actuators.unwritten == found.actuators.dropped == ()


@sampled("drives", SETS, "reads USD in processes of its own", ids=["limits", "laws", "others"])
def test_all_that_is_written_is_in_newtons_schemas(arm, drives):
    from pxr import Sdf

    spec = importlib.util.find_spec("newton_usd_schemas")
    if spec is None or spec.origin is None:
        pytest.skip("needs newton-usd-schemas: pip install newton-usd-schemas")
    known = Sdf.Layer.OpenAsAnonymous(str(Path(spec.origin).with_name("generatedSchema.usda")))
    load = Payload(mass=0.5, com=(0, 0, 0.1))
    file = exported(arm, drives, (*EFFECTS, load))[0]
    layer, many = Sdf.Layer.FindOrOpen(str(file)), 0
    for spec in layer.GetPrimAtPath("/robot").nameChildren:
        applied = spec.GetInfo("apiSchemas")
        named = [*applied.prependedItems, *applied.explicitItems, spec.typeName]
        own = [known.GetPrimAtPath(f"/{name}") for name in named if name.startswith("Newton")]
        assert all(own)
        expected = {name: x for schema in own for name, x in schema.properties.items()}
        for written in spec.properties:
            if written.name.startswith("newton:"):
                assert isinstance(written, type(expected[written.name]))
                if isinstance(written, Sdf.AttributeSpec):
                    assert written.typeName == expected[written.name].typeName
                    low = expected[written.name].GetInfo("limits").get("hard", {}).get("minimum")
                    assert low is None or written.default >= low
                many += 1
    assert many >= 9


def test_limits_delays_and_motors_are_those_of_the_drives(arm):
    place, found, at = exported(arm, SETS[0])
    one, two = at("turns_a_actuator"), at("turns_b_actuator")
    assert one.GetTypeName() == "NewtonActuator"
    assert one.GetRelationship("newton:targets").GetTargets() == ["/robot/turns_a"]
    pd = "NewtonPDControlAPI"
    assert schemas(one) == [pd, "NewtonMaxEffortClampingAPI", "NewtonActuatorDelayAPI"]
    assert schemas(two) == [pd, "NewtonDCMotorClampingAPI"]
    expected = {"kp": 17.5, "kd": 0.8, "maxEffort": 3.0, "delaySteps": 14}
    assert numbers(one) == pytest.approx(expected)
    line = {"saturationEffort": 12.8, "velocityLimit": 30.0, "maxMotorEffort": 5.0}
    assert numbers(two) == pytest.approx({"kp": 16.0, "kd": 0.6, **line})
    assert found.actuators.unwritten == (
        "0.0005 s of the delay of turns_a: a NewtonActuator has whole steps, of 0.001 s",
        "the rate of steps of delays: no scene states one, 1000 Hz is taken",
    )
    read = Simulation.load(place)
    assert [drive.torque_limit for drive in read.drives] == [3.0, 5.0]
    assert read.drives[0].delay == pytest.approx(0.014)
    said = "not represented: NewtonDCMotorClampingAPI of turns_b_actuator"
    assert said in read.model.notes


@pytest.mark.slow("reads USD in processes of its own")
def test_delays_count_in_steps_of_the_scene(arm):
    def scene(stage):
        from pxr import Sdf, UsdPhysics

        prim = UsdPhysics.Scene.Define(stage, "/scene").GetPrim()
        prim.CreateAttribute("newton:timeStepsPerSecond", Sdf.ValueTypeNames.Int).Set(2000)

    edited(arm, scene)
    place, found, at = exported(arm, SETS[0])
    assert numbers(at("turns_a_actuator"))["delaySteps"] == 29
    assert found.actuators.unwritten == ()
    assert Simulation.load(place).drives[0].delay == pytest.approx(DELAYED.delay)


def test_laws_are_those_of_the_drives_and_the_rest_is_told(arm):
    place, found, at = exported(arm, (INTEGRAL, replace(TOLD, delay=0.002)))
    expected = {"kp": 17.5, "kd": 0.8, "ki": 4.0, "integralMax": 0.5}
    assert numbers(at("turns_a_actuator")) == pytest.approx(expected)
    assert schemas(at("turns_a_actuator")) == ["NewtonPIDControlAPI"]
    told = {"kp": 0.0, "kd": 0.0, "maxEffort": 30.0, "delaySteps": 2}
    assert numbers(at("turns_b_actuator")) == pytest.approx(told)
    said = "gain 2 1 of the servo of turns_b: no torque actuator has it"
    assert said in found.actuators.unwritten
    assert RobotModel(place).description.motors["turns_b"].delay == pytest.approx(0.002)
    place, found, at = exported(arm, (TURNING,), name="turning")
    assert numbers(at("turns_a_actuator")) == pytest.approx({"kp": 0.0, "kd": 3.5})
    said = "ki 8 N m/rad of the servo of turns_a: no velocity actuator has it"
    assert found.actuators.unwritten == (said,)
    assert Simulation.load(place).drives == (VelocityServo(joint=1, kv=3.5),)


def test_a_dead_band_and_punch_are_a_network(arm):
    runtime = pytest.importorskip("onnxruntime")
    place, found, at = exported(arm, (LOOSE,))
    prim = at("turns_b_actuator")
    assert schemas(prim) == ["NewtonNeuralControlAPI", "NewtonMaxEffortClampingAPI"]
    file = place.parent / numbers(prim)["modelPath"].path
    assert file in found.actuators.files
    assert found.actuators.unwritten == ()
    session = runtime.InferenceSession(file)
    props = session.get_modelmeta().custom_metadata_map
    assert props == {"model_type": "mlp", "input_order": "pos_vel", "input_idx": "[0]"}
    e, dq = np.random.default_rng(0).uniform(-0.05, 0.05, (2, 500, 1))
    dq *= 20
    beyond = np.sign(e) * np.maximum(np.abs(e) - LOOSE.dead_band, 0.0)
    punch = np.sign(e) * LOOSE.punch * np.clip(np.abs(beyond) / 1e-3, 0.0, 1.0)
    law = LOOSE.kp * beyond + punch - LOOSE.kd * dq
    (torque,) = session.run(None, {"input": np.hstack([e, dq]).astype(np.float32)})
    np.testing.assert_allclose(torque, law, atol=1e-4)


def driven(stage):
    from pxr import UsdPhysics

    for name in ("turns_a", "turns_b"):
        drive = UsdPhysics.DriveAPI(stage.GetPrimAtPath(f"/robot/{name}"), "angular")
        drive.CreateStiffnessAttr().Set(float(np.deg2rad(16.0)))
        drive.CreateDampingAttr().Set(float(np.deg2rad(0.6)))


@pytest.mark.slow("reads USD in processes of its own")
def test_the_actuator_is_the_whole_drive_and_a_drive_that_is_there_stays(arm):
    edited(arm, driven)
    same = replace(LIMITED, torque_limit=50.0)  # as the file has it
    place, found, at = exported(arm, (DELAYED, same))
    word = "drive:angular:physics:stiffness"
    assert at("turns_a").GetAttribute(word).Get() == 0.0
    assert at("turns_b").GetAttribute(word).Get() == pytest.approx(np.deg2rad(16.0))
    assert not at("turns_b_actuator")
    said = "joint turns_a: its UsdPhysics drive, for which the NewtonActuator is"
    assert found.actuators.dropped == (said,)
    _, again, _ = exported(place, (DELAYED, same), name="again")
    assert "newton" not in again.text
    assert again.actuators.dropped == ()


@pytest.mark.slow("reads USD in processes of its own")
def test_an_actuator_of_the_file_is_the_one_that_changes(arm):
    def shared(stage):
        for name in ("both", "more"):
            prim = stage.DefinePrim(f"/robot/{name}", "NewtonActuator")
            prim.AddAppliedSchema("NewtonPDControlAPI")
            targets = ["/robot/turns_b", "/robot/turns_a"][: 2 if name == "both" else 1]
            prim.CreateRelationship("newton:targets").SetTargets(targets)

    edited(arm, shared)
    *_, at = exported(arm, (DELAYED, LIMITED))
    for name, joint in (("both", "turns_b"), ("turns_a_actuator", "turns_a")):
        assert at(name).GetRelationship("newton:targets").GetTargets() == [f"/robot/{joint}"]
    assert not at("more").IsActive()
    assert numbers(at("both"))["kp"] == 16.0


# Read -------------------------------------------------------------------------------------------


@pytest.mark.slow("reads USD in processes of its own")
def test_a_file_in_newtons_words_alone_is_read(arm):
    def write(stage):
        from pxr import Sdf

        joint, body = stage.GetPrimAtPath("/robot/turns_a"), stage.GetPrimAtPath("/robot/lower")
        kinds = Sdf.ValueTypeNames
        for name, value in (("friction", 0.7), ("armature", 0.1), ("damping", 0.02)):
            joint.CreateAttribute(f"newton:{name}", kinds.Float).Set(value)
        joint.CreateAttribute("physxJoint:armature", kinds.Float).Set(0.3)
        six = body.CreateAttribute("newton:inertia", kinds.DoubleArray)
        six.Set([0.02, 0.025, 0.03, 0.001, 0.002, -0.003])
        body.RemoveProperty("physics:diagonalInertia")

    edited(arm, write)
    model = RobotModel(arm)
    own = model.description.dynamics["turns_a"]
    assert own.friction == pytest.approx(0.7)
    assert own.damping == pytest.approx(0.02 * 180 / np.pi)
    assert own.armature == pytest.approx(0.3)
    said = "joint turns_a has armature = 0.3 in PhysX's words, which counts, and newton:armature"
    assert model.notes[0].startswith(said)
    tensor = [[0.02, 0.001, 0.002], [0.001, 0.025, -0.003], [0.002, -0.003, 0.03]]
    np.testing.assert_allclose(model.inertials["lower"].tensor(), tensor, atol=1e-12)


@pytest.mark.slow("reads USD in processes of its own")
def test_an_inertia_in_newtons_words_changes_with_the_other(arm):
    def write(stage):
        from pxr import Sdf

        body = stage.GetPrimAtPath("/robot/lower")
        body.CreateAttribute("newton:inertia", Sdf.ValueTypeNames.DoubleArray).Set([0.01] * 6)

    edited(arm, write)
    load = Payload(mass=0.5, com=(0, 0, 0.1))
    place, _, at = exported(arm, (), (load,))
    xx, yy, zz, xy, xz, yz = at("lower").GetAttribute("newton:inertia").Get()
    tensor = RobotModel(place).inertials["lower"].tensor()
    np.testing.assert_allclose(tensor, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-7)


@pytest.mark.slow("reads USD in processes of its own")
def test_a_joint_that_newton_has_mimic_another_follows_it(arm):
    def write(stage):
        from pxr import Sdf

        joint = stage.GetPrimAtPath("/robot/turns_b")
        joint.CreateRelationship("newton:mimicJoint").SetTargets(["/robot/turns_a"])
        for name, value in (("mimicCoef0", 9.0), ("mimicCoef1", -0.5)):
            joint.CreateAttribute(f"newton:{name}", Sdf.ValueTypeNames.Float).Set(value)

    edited(arm, write)
    model = RobotModel(arm)
    assert model.joint_names == ("turns_a",)
    position = model.linkage.positions(np.array([[0.2]]))
    np.testing.assert_allclose(position, [[0.2, np.deg2rad(9.0) - 0.1]], atol=1e-7)
