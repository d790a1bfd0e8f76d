"""Descriptions of arms as they are found: each plans, runs, identifies, diagnoses and exports."""

from __future__ import annotations

import re
from importlib.metadata import files
from pathlib import Path

import numpy as np
from lanes import sampled
from linked_arms import gripper, parallelogram, pincer_arm
from mjcf_arms import arm_of
from tables import rows_of
from usd_arms import usd_of

import limo_driver as limo
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.types import Motion

# In the document's table by file name; the part after # chooses joints.
ROBOTS = (
    "iiwa14",
    "model.xml",
    "play.xml",
    "arm.usda",
    "panda.urdf",
    "ur5_robot.urdf",
    "ur5_gripper.urdf",
    "ur10_robot.urdf",
    "so101.urdf",
    "z1.urdf",
    "kinova.urdf",
    "xarm7.urdf",
    "panda.urdf#panda_joint*,panda_finger_joint1,panda_finger_joint2=0.02",
    "tiago.urdf#arm_*",
    "tiago.urdf#torso_lift_joint,arm_*",
    "gripper.urdf#yaw,shoulder,elbow,finger_b",
    "linkage.xml",
    "pincers.xml",
    "two_arms.xml#left/yaw,left/shoulder,left/elbow",
)
# a URDF whose joints follow others, and an MJCF whose linkages close
QUICK = ("gripper.urdf#yaw,shoulder,elbow,finger_b", "pincers.xml")
MADE = {
    "gripper.urdf": gripper,  # joints follow others
    "linkage.xml": parallelogram,
    "pincers.xml": pincer_arm,  # classes of defaults, servos, a hand whose linkages close
    "two_arms.xml": lambda: pincer_arm(("left/", "right/")),
}
STEPS = ["plans", "runs", "identifies", "diagnoses", "exports"]
SHORT = limo.PlanRequest(scaffolds=1, exploring=limo.Exploring(waypoints=(150, 200)))


def place_of(robot, folder):
    """Path of a description of the package example-robot-data, or of one that is made here."""
    if robot == "iiwa14":
        return robot
    if robot == "model.xml":
        (folder / robot).write_text(arm_of(11, 5, dynamics=False), encoding="utf-8")
        return str(folder / robot)
    if robot == "play.xml":
        hinge = '<joint name="slack" axis="0 1 0" range="-.001 .001" limited="true"/>'
        text = arm_of(12, 4, dynamics=False)
        joint = next(line for line in text.splitlines() if 'name="hinge1"' in line)
        axis, pos = (re.search(rf'{key}="([^"]*)"', joint)[1] for key in ("axis", "pos"))
        slack = hinge.replace("0 1 0", axis).replace("/>", f' pos="{pos}"/>')
        driven = joint.replace("<joint", '<joint armature="0.1"', 1)
        text = text.replace(joint, f"{driven}{slack}")
        (folder / robot).write_text(text, encoding="utf-8")
        return str(folder / robot)
    if robot == "arm.usda":
        return str(usd_of(limo.RobotModel.load("iiwa14"), folder / robot))
    name, mark, joints = robot.partition("#")
    if name in MADE:
        (folder / name).write_text(MADE[name](), encoding="utf-8")
        return f"{folder / name}{mark}{joints}"
    found = next(x for x in files("example-robot-data") if x.name == name)
    return f"{Path(str(found.locate())).resolve()}{mark}{joints}"


def kinds_for(robot):
    """The formats that a robot is exported to; USD is a layer over a USD file."""
    return ("mjcf", "urdf", "drake", "isaaclab") + ("usd",) * robot.endswith(".usda")


def motion_of(model):
    """16 s of sinusoids through part of each joint's range."""
    time = np.arange(0, 16, 0.01)
    rate = 2 * np.pi * (0.11 + 0.05 * np.arange(model.n))
    limits = model.limits
    reach = np.minimum(0.8, 0.4 * (limits.position_max - limits.position_min))
    reach = np.minimum(reach, 0.9 * limits.velocity / rate)
    phase = np.outer(time, rate) + np.arange(model.n)
    q = (limits.position_min + limits.position_max) / 2 + reach * np.sin(phase)
    return Motion(time, q, reach * rate * np.cos(phase), -reach * rate**2 * np.sin(phase))


def test_the_table_is_that_of_the_document():
    heading, cells = rows_of("robot")
    assert heading[1:] == STEPS
    assert [row[0].strip("`") for row in cells] == list(ROBOTS)
    for robot, row in zip(ROBOTS, cells, strict=True):
        assert row[1:] == ["yes"] * 4 + [", ".join(kinds_for(robot))]


@sampled(
    "robot",
    [*QUICK, *(robot for robot in ROBOTS if robot not in QUICK)],
    "plans, runs, identifies, diagnoses and exports each robot",
    first=len(QUICK),
)
def test_a_robot_as_it_is_found(robot, tmp_path):
    place = place_of(robot, tmp_path)
    model = limo.RobotModel.load(place)
    planned = limo.plan(model, SHORT, seed=1)
    motion = motion_of(model)
    friction = [CoulombFriction(joint=j + 1, tau_c=0.6, v_eps=0.005) for j in range(model.n)]
    friction += [ViscousFriction(joint=j + 1, f_v=0.4) for j in range(model.n)]
    torque = Simulation(place, tuple(friction)).predict(motion)
    torque += np.random.default_rng(0).normal(0, 0.02, torque.shape)
    recording = limo.Recording.from_arrays(motion.time, motion.position, torque)
    found = limo.identify(place, recording).simulation
    dry = [e.tau_c for e in found.effects if e.name == "coulomb_friction"]
    np.testing.assert_allclose(dry, 0.6, atol=0.1)
    diagnosis = limo.diagnose(limo.nominal(place, recording), recording)
    assert diagnosis.verdict.verdict in {"consistent", "explained"}
    assert not diagnosis.failures
    for kind in kinds_for(robot):
        exported = limo.export(found, kind, tmp_path / kind)
        assert exported.share < 0.01
        if followers := model.description.followers:
            again = limo.RobotModel.load(exported.file).with_joints(model.joint_names)
            assert again.description.followers == followers
    with limo.open_robot("mujoco", simulation=found, seed=1) as arm:
        run = arm.follow(planned)
    np.testing.assert_allclose(run.position[-1], planned.trajectory.position[-1], atol=0.01)
