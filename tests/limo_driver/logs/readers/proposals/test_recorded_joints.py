"""Logs that name some joints of a robot: those are taken, the others locked, and that is said."""

import re
from dataclasses import replace
from importlib.metadata import files
from pathlib import Path

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.logs.readers.mapping import LogMapping

# name, parent and child, axis, range; the column yaws, the back tilts what stands on it
JOINTS = (
    ("column", "base", "trunk", "0 0 1", "-2 2"),
    ("back", "trunk", "chest", "0 1 0", "0.2 1"),
    ("shoulder", "chest", "upper", "0 1 0", "-2 2"),
    ("elbow", "upper", "lower", "0 1 0", "-2 2"),
    ("claw", "lower", "tip", "1 0 0", "-1 1"),
    ("neck", "chest", "head", "0 1 0", "-1 1"),
)
LINK = (
    '<link name="{}"><inertial><origin xyz="0 0 .2"/><mass value="{}"/><inertia ixx=".03" ixy="0" '
    'ixz="0" iyy=".03" iyz="0" izz=".01"/></inertial></link>'
)
JOINT = (
    '<joint name="{}" type="revolute"><parent link="{}"/><child link="{}"/><origin xyz="0 0 .4"/>'
    '<axis xyz="{}"/><limit lower="{}" upper="{}" effort="100" velocity="3"/></joint>'
)
ARM = ("shoulder", "elbow")


@pytest.fixture
def robot(tmp_path):
    names = ("base", *(child for _, _, child, _, _ in JOINTS))
    links = [LINK.format(name, 0.2 if name in {"tip", "head"} else 2) for name in names]
    joints = [JOINT.format(*own, *limits.split()) for *own, limits in JOINTS]
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(links + joints)}</robot>', encoding="utf-8")
    return str(path)


def log_of(robot, recorded=ARM, places=None):
    """12 s of motion of some joints, the others at their places; the names say the unit."""
    model = limo.RobotModel.load(robot)
    time = np.arange(0, 12, 0.01)
    rate = 2 * np.pi * (0.11 + 0.07 * np.arange(model.n))
    phase = np.outer(time, rate) + np.arange(model.n)
    low, high = model.limits.position_min, model.limits.position_max
    reach = np.minimum(0.8, 0.4 * (high - low))
    q = (low + high) / 2 + reach * np.sin(phase)
    v, a = reach * rate * np.cos(phase), -reach * rate**2 * np.sin(phase)
    for j, name in enumerate(model.joint_names):
        if name not in recorded:
            q[:, j], v[:, j], a[:, j] = (places or {}).get(name, 0.2 if name == "back" else 0), 0, 0
    torque = model.inverse_dynamics(q, v, a) + 0.5 * np.tanh(v / 0.005)
    torque += np.random.default_rng(0).normal(0, 0.02, q.shape)
    columns = {"t": time}
    for j, name in enumerate(model.joint_names):
        if name in recorded:
            columns |= {f"{name}_pos_rad": q[:, j], f"{name}_effort_nm": torque[:, j]}
    return columns, *(dict(zip(model.joint_names, x.T, strict=True)) for x in (q, torque))


def of(values, *names):
    return np.column_stack([values[name] for name in names])


def test_joints_that_the_log_names_are_taken_and_the_others_locked(robot):
    log, q, _ = log_of(robot, ("back", *ARM))
    recording = limo.read(log, robot)
    assert recording.robot.endswith("robot.urdf#back,shoulder,elbow")
    np.testing.assert_allclose(recording.position, of(q, "back", *ARM))
    said = "of the 6 joints of robot.urdf those that the log names are taken: back, shoulder, elbow"
    assert f"{said}; locked: column, neck, claw at 0" in recording.warnings[0]
    assert any(said in note for note in limo.inspect(log, robot).notes())
    found = limo.identify(robot, recording).simulation
    dry = [e.tau_c for e in found.effects if e.name == "coulomb_friction"]
    np.testing.assert_allclose(dry, 0.5, atol=0.05)
    assert found.model.joint_names == ("back", "shoulder", "elbow")


def test_a_file_keeps_which_joints_it_is_of(robot, tmp_path):
    log, _, torque = log_of(robot, ("back", *ARM))
    limo.read(log, robot).save(tmp_path / "run.parquet")
    recording = limo.read(tmp_path / "run.parquet", robot)
    np.testing.assert_allclose(recording.torque, of(torque, "back", *ARM))
    assert limo.nominal(robot, recording).model.n == 3


def test_where_a_joint_stood_that_tilts_the_others_is_asked(robot, tmp_path):
    log, _, torque = log_of(robot, places={"back": 0.7})
    with pytest.raises(ConfigError, match=r"place of joint back changes .* say it: where was"):
        limo.read(log, robot)
    recording = limo.read(log, f"{robot}#back=0.7")
    np.testing.assert_allclose(recording.torque, of(torque, *ARM))
    found = limo.inspect(log, robot)
    assert not any("column" in question for question in found.questions)  # which only yaws
    found.mapping.save(tmp_path / "mapping.yaml")
    text = (tmp_path / "mapping.yaml").read_text()
    answered = re.sub("undecided:.*", "undecided: []", text, flags=re.DOTALL)
    answered = answered.replace("#shoulder,elbow", "#shoulder,elbow,back=0.7")
    (tmp_path / "mapping.yaml").write_text(answered)
    assert limo.read(log, robot, LogMapping.load(tmp_path / "mapping.yaml")).robot.endswith(
        "#shoulder,elbow,back=0.7"
    )


def test_where_a_joint_stood_that_hangs_on_the_others_is_asked_if_it_is_heavy(robot):
    log, _, _ = log_of(robot, ("back", "shoulder"))
    found = limo.inspect(log, robot)
    assert re.findall("place of joint ([a-z]+)", " ".join(found.questions)) == ["elbow"]


def test_a_joint_without_torque_is_locked_where_the_log_has_it(robot):
    log, q, _ = log_of(robot, places={"back": 0.7, "neck": -0.3})
    log |= {"back_pos_rad": q["back"], "neck_pos_rad": q["neck"]}
    recording = limo.read(log, robot)
    assert recording.robot.endswith("#shoulder,elbow,back=0.7,neck=-0.3")
    assert "locked: column, claw at 0; back at 0.7; neck at -0.3" in recording.warnings[0]
    log["back_pos_rad"] = 0.7 + 0.1 * np.sin(log["t"])
    with pytest.raises(
        ConfigError, match=r"joint back changes .* by 0\.2 and .* taken for locked at"
    ):
        limo.read(log, robot)


def test_a_log_that_ends_within_a_series_of_joints_is_refused(tmp_path, robot):
    path = series_of(robot, tmp_path)
    log, _, _ = log_of(path, ("back", "arm_1", "arm_2"))
    with pytest.raises(
        RecordingError, match=r"lacks column, arm_3, neck; .* named after a # of it"
    ):
        limo.read(log, path)
    assert limo.read(log, f"{path}#back,arm_1,arm_2").n == 3


def test_a_joint_is_locked_as_near_to_zero_as_it_can_be(robot):
    model = limo.RobotModel.load(f"{robot}#shoulder,elbow")
    assert model.description.locked == {"column": 0, "back": 0.2, "claw": 0, "neck": 0}
    assert "joint back is locked at 0.2; what it carries is lumped" in model.notes


@pytest.mark.slow("reads a description of 48 joints again and again")
def test_a_log_of_a_torso_and_an_arm_is_of_8_of_the_joints_of_tiago():
    found = next(file for file in files("example-robot-data") if file.name == "tiago.urdf")
    robot = str(found.locate())
    arm = limo.RobotModel.load(f"{robot}#torso_lift_joint,arm_*")
    limits, time = arm.limits, np.arange(0, 4, 0.01)
    reach = 0.4 * (limits.position_max - limits.position_min)
    phase = np.outer(time, 0.7 + 0.2 * np.arange(arm.n)) + np.arange(arm.n)
    q = (limits.position_min + limits.position_max) / 2 + reach * np.sin(phase)
    torque = arm.gravity_torque(q)
    log = {"t": time, "gripper_pos": time}
    for j, name in enumerate(arm.joint_names):
        log[f"{name}_pos[{'m' if arm.sliding[j] else 'rad'}]"] = q[:, j]
        log[f"{name}_effort"] = torque[:, j]
    recording = limo.read(log, robot)
    assert limo.RobotModel.load(recording.robot).joint_names == arm.joint_names
    np.testing.assert_allclose(recording.position, q)
    assert "of the 48 joints of tiago.urdf" in recording.warnings[0]
    assert re.search(r"locked: hand_index_abd_joint, .* and 32 more at 0", recording.warnings[0])
    # a slide changes no angle to gravity: where it stood is not asked
    without = {key: values for key, values in log.items() if "torso" not in key}
    assert limo.read(without, robot).n == 7


LIMB = '<geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/>'
WITH_FINGER = (
    '<mujoco><compiler angle="radian"/><worldbody>'
    f'<body name="upper"><joint name="a" axis="0 1 0" range="-2 2"/>{LIMB}'
    f'<body name="lower" pos="0 0 .3"><joint name="b" axis="0 1 0" range="-2 2"/>{LIMB}'
    '<body name="tip" pos="0 0 .3"><joint name="f" type="slide" axis="{axis}" range="0 .3"/>'
    '<geom size=".05" mass="{mass}"/></body></body></body></worldbody></mujoco>'
)


@pytest.fixture
def whole(tmp_path):
    """An arm with a finger, and arrays of all its joints as MuJoCo has them."""

    def make(finger, axis="1 0 0", mass=0.2, reference="#"):
        path = tmp_path / "arm.xml"
        path.write_text(WITH_FINGER.format(axis=axis, mass=mass), encoding="utf-8")
        time = np.arange(0, 6, 0.01)
        q = np.stack([0.8 * np.sin(time), 0.6 * np.sin(2 * time + 1), finger + 0 * time], axis=1)
        log = tmp_path / "log.npz"
        np.savez(log, time=time, qpos=q, qvel=np.gradient(q, time, axis=0), qfrc_actuator=np.sin(q))
        return f"{path}{reference}".rstrip("#"), log

    return make


def test_a_gripper_is_locked_where_a_log_of_the_whole_model_has_it(whole):
    robot, log = whole(0.04)
    assert limo.RobotModel.load(robot).description.locked == {"f": 0.0}
    found = limo.inspect(log, robot)
    assert limo.RobotModel.load(found.mapping.robot).description.locked == {"f": 0.04}
    assert found.mapping.joints == ("a", "b")
    assert "locked where the log has them: f at 0.04" in found.notes()


def test_a_place_that_was_stated_stays(whole):
    robot, log = whole(0.04, reference="#f=0.1")
    found = limo.inspect(log, robot)
    assert limo.RobotModel.load(found.mapping.robot).description.locked == {"f": 0.1}


def test_a_joint_that_moves_and_weighs_is_asked_for(whole):
    time = np.arange(0, 6, 0.01)
    robot, log = whole(0.15 + 0.1 * np.sin(time), mass=5)
    (question,) = [q for q in limo.inspect(log, robot).questions if q.startswith("robot:")]
    assert "the place of joint f changes what gravity asks of the others" in question
    light, log = whole(0.15 + 0.1 * np.sin(time), mass=0.01)
    assert not [q for q in limo.inspect(log, light).questions if q.startswith("robot:")]


def series_of(robot, tmp_path):
    """The robot with three joints that differ in their numbers alone."""
    text = Path(robot).read_text(encoding="utf-8")
    for k, name in enumerate(("shoulder", "elbow", "claw")):
        text = text.replace(f'joint name="{name}"', f'joint name="arm_{k + 1}"')
    path = tmp_path / "series.urdf"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_of_a_series_some_joints_may_lack_a_torque(tmp_path, robot):
    path = series_of(robot, tmp_path)
    log, q, torque = log_of(path, ("back", "arm_1", "arm_2", "arm_3"))
    del log["arm_2_effort_nm"]
    recording = limo.read(log, path)
    assert recording.robot.endswith("#back,arm_1,arm_2,arm_3")
    np.testing.assert_allclose(recording.position, of(q, "back", "arm_1", "arm_2", "arm_3"))
    known = of(torque, "back", "arm_1", "arm_2", "arm_3") * [1, 1, 0, 1]
    np.testing.assert_allclose(recording.torque, known)
    assert "torque_3 is never measured; it is kept as 0" in recording.warnings
    found = limo.inspect(log, path)
    assert found.mapping.torque.columns[2] == "-"
    assert "the log has none of arm_2" in str(found)
    found.mapping.save(tmp_path / "mapping.yaml")
    again = limo.read(log, path, LogMapping.load(tmp_path / "mapping.yaml"))
    np.testing.assert_allclose(again.torque, known)


def test_positions_may_not_lack_a_joint(robot):
    log, _, _ = log_of(robot, ("back", *ARM))
    mapping = limo.inspect(log, robot).mapping
    given = replace(mapping.position, columns=("back_pos_rad", "-", "elbow_pos_rad"))
    with pytest.raises(ConfigError, match="position: has no column of joint shoulder; only torq"):
        replace(mapping, position=given)
