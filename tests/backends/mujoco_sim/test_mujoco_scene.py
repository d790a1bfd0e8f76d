"""MuJoCo and pinocchio see the same arm, from the same file."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest

from backends.mujoco_sim.realisation import draft_of
from backends.mujoco_sim.scene import compile_model
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[4] / "shared" / "data"))

GRIPPER = """<robot name="two">
  <link name="base"/>
  <joint name="a" type="revolute">
    <parent link="base"/><child link="upper"/>
    <origin xyz="0 0 0.1" rpy="0.3 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="50" velocity="1"/><dynamics damping="3" friction="2"/>
  </joint>
  <link name="upper">
    <inertial><origin xyz="0 0.1 0.2" rpy="0.2 0.1 0"/><mass value="3"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/upper.dae"/></geometry></visual>
    <collision><geometry><mesh filename="package://nowhere/upper.stl"/></geometry></collision>
  </link>
  <joint name="b" type="revolute">
    <parent link="upper"/><child link="hand"/>
    <origin xyz="0 0 0.4" rpy="0 0 0.5"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="20" velocity="1"/>
  </joint>
  <link name="hand">
    <inertial><origin xyz="0 0 0.1"/><mass value="1"/>
      <inertia ixx="0.002" ixy="0" ixz="0" iyy="0.002" iyz="0" izz="0.001"/></inertial>
    <collision><geometry><sphere radius="0.05"/></geometry></collision>
  </link>
  <joint name="finger_joint" type="prismatic">
    <parent link="hand"/><child link="finger"/>
    <origin xyz="0 0.03 0.15" rpy="0 0 0"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="1"/>
  </joint>
  <link name="finger">
    <inertial><origin xyz="0 0 0.02" rpy="0 0 0"/><mass value="0.2"/>
      <inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0001" iyz="0" izz="0.0001"/></inertial>
    <collision><geometry><box size="0.02 0.02 0.04"/></geometry></collision>
  </link>
</robot>"""


def assert_same_arm(robot):
    plant = draft_of((), robot.n).plant(np.zeros(robot.n))
    model = compile_model(robot, plant, 1e-3)
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    for _ in range(10):
        q, dq = random.uniform(-1.5, 1.5, (2, robot.n))
        data.qpos[:], data.qvel[:] = q, dq
        mujoco.mj_forward(model, data)
        inertia = np.zeros((robot.n, robot.n))
        mujoco.mj_fullM(model, data, inertia)
        assert np.abs(inertia - robot.mass_matrix(q)).max() < 1e-9
        bias = robot.inverse_dynamics(q[None], dq[None], np.zeros((1, robot.n)))[0]
        assert np.abs(data.qfrc_bias - bias).max() < 1e-9
        poses = robot.joint_poses(q)
        for j, link in enumerate(robot.link_names):
            body = data.body(link)
            assert np.abs(body.xpos - poses[j, :3, 3]).max() < 1e-9
            assert np.abs(body.xmat.reshape(3, 3) - poses[j, :3, :3]).max() < 1e-9
    assert not model.dof_damping.any()
    assert not model.dof_frictionloss.any()


def test_iiwa_is_the_same_to_both_engines():
    assert_same_arm(RobotModel.load("iiwa14"))


def test_other_inertias_are_the_same_to_both_engines():
    heavy = Inertial(mass=5.0, com=(0.01, 0.05, 0.02), inertia=(0.03, 0.001, 0, 0.03, 0, 0.01))
    assert_same_arm(RobotModel.load("iiwa14", {"link4": heavy}))


def test_absent_meshes_and_locked_fingers_are_the_same_to_both_engines(tmp_path):
    urdf = tmp_path / "two.urdf"
    urdf.write_text(GRIPPER)
    robot = RobotModel.load(urdf)
    assert robot.joint_names == ("a", "b")
    assert any("finger_joint" in note and "locked" in note for note in robot.notes)
    assert robot.inertials["hand"].mass == pytest.approx(1.2)
    assert_same_arm(robot)


@pytest.mark.parametrize("name", ["ur10e/ur10e.urdf", "kuka_lwr4/kuka_lwr4.urdf"])
def test_urdfs_of_real_arms_are_the_same_to_both_engines(name):
    if not (DATA / name).is_file():
        pytest.skip(f"no {name} under {DATA}; set LIMO_DATA")
    assert_same_arm(RobotModel.load(DATA / name))


def test_a_urdf_that_changes_after_it_was_read_is_not_read_again(tmp_path):
    urdf = tmp_path / "two.urdf"
    urdf.write_text(GRIPPER)
    robot = RobotModel.load(urdf)
    urdf.write_text("<robot name='two'><link name='base'></robot>")
    assert compile_model(robot, draft_of((), 2).plant(np.zeros(2)), 1e-3).njnt == 2
