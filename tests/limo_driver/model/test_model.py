"""The robot model agrees with MuJoCo, which reads the same URDF.

The wrench that explains external torques: found where it was, and as surely as stated.
"""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path

import mujoco
import numpy as np
import pytest

from backends.can.config import ArmConfig, Bus, Cia402Joint
from limo_driver.errors import ConfigError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.model.kinematics import FlangeWrench
from limo_driver.robot.registry import open_robot

AGREE = 1e-6


@pytest.fixture(scope="module")
def model():
    return RobotModel.load("iiwa14")


@pytest.fixture(scope="module")
def mujoco_model(model):
    options = (
        '<mujoco><compiler fusestatic="false" balanceinertia="false"/>'
        '<option><flag constraint="disable"/></option></mujoco>'
    )
    urdf = Path(model.urdf).read_text()
    start = urdf.index(">", urdf.index("<robot")) + 1
    return mujoco.MjModel.from_xml_string(urdf[:start] + options + urdf[start:])


@pytest.fixture(scope="module")
def poses(model):
    random = np.random.default_rng(3)
    return random.uniform(model.limits.position_min, model.limits.position_max, (20, model.n))


def test_flange_pose_agrees_with_mujoco(model, mujoco_model, poses):
    data = mujoco.MjData(mujoco_model)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(mujoco_model, data)
        flange = data.body("flange")
        pose = model.flange_pose(q)
        np.testing.assert_allclose(pose[:3, 3], flange.xpos, atol=AGREE)
        np.testing.assert_allclose(pose[:3, :3], flange.xmat.reshape(3, 3), atol=AGREE)


def test_mass_matrix_agrees_with_mujoco(model, mujoco_model, poses):
    data = mujoco.MjData(mujoco_model)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_forward(mujoco_model, data)
        M = np.zeros((model.n, model.n))
        mujoco.mj_fullM(mujoco_model, data, M)
        np.testing.assert_allclose(model.mass_matrix(q), M, atol=AGREE)
        column = model.inertia_of(q[None], 1)[0]
        np.testing.assert_allclose(column, M[1], atol=AGREE)


def test_gravity_torque_agrees_with_mujoco(model, mujoco_model, poses):
    data = mujoco.MjData(mujoco_model)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_forward(mujoco_model, data)
        np.testing.assert_allclose(model.gravity_torque(q)[0], data.qfrc_bias, atol=AGREE)


def test_inverse_dynamics_agrees_with_mujoco(model, mujoco_model, poses):
    data = mujoco.MjData(mujoco_model)
    dq, ddq = 0.5 * poses[::-1], 2.0 * poses[::2].repeat(2, axis=0)
    torque = model.inverse_dynamics(poses, dq, ddq)
    for q, v, a, tau in zip(poses, dq, ddq, torque, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        mujoco.mj_inverse(mujoco_model, data)
        np.testing.assert_allclose(tau, data.qfrc_inverse, atol=AGREE)


def test_limits_are_those_of_the_data_sheet(model):
    np.testing.assert_allclose(
        np.degrees(model.limits.position_max), [170, 120, 170, 120, 170, 120, 175]
    )
    np.testing.assert_allclose(np.degrees(model.limits.velocity), [85, 85, 100, 75, 130, 135, 135])
    np.testing.assert_array_equal(model.limits.torque, [320, 320, 176, 176, 110, 40, 40])


def test_heavier_link_needs_more_torque(model):
    nominal = model.inertials["link7"]
    heavier = model.with_inertials(
        {"link7": Inertial(nominal.mass + 1.0, nominal.com, nominal.inertia)}
    )
    stretched = np.array([[0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0]])
    more = heavier.gravity_torque(stretched) - model.gravity_torque(stretched)
    reach = 0.42 + 0.4 + 0.081 + nominal.com[2]
    assert abs(more[0, 1]) == pytest.approx(9.81 * reach, rel=1e-6)


def test_unknown_robot_and_link_and_impossible_body_are_named(model):
    with pytest.raises(ConfigError, match=r"'iiwa15' is neither built in \(iiwa14\) nor"):
        RobotModel.load("iiwa15")
    body = model.inertials["link1"]
    with pytest.raises(ConfigError, match="no moving link 'link9'"):
        model.with_inertials({"link9": body})
    with pytest.raises(ConfigError, match="no rigid body has the mass -1 kg"):
        model.with_inertials({"link1": Inertial(-1.0, body.com, body.inertia)})


def test_shapes_are_checked(model):
    with pytest.raises(ShapeError, match=r"velocity has shape \(2, 6\), expected \(T, 7\)"):
        model.inverse_dynamics(np.zeros((2, 7)), np.zeros((2, 6)), np.zeros((2, 7)))


ONE_JOINT = """<robot name="pendulum"><link name="base"/><link name="arm"><inertial>
<origin xyz="0 0 0.5"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" velocity="2" effort="50"/></joint></robot>"""


def test_an_arm_of_one_joint_has_torques_of_one_joint(tmp_path):
    (tmp_path / "pendulum.urdf").write_text(ONE_JOINT)
    pendulum = RobotModel.load(str(tmp_path / "pendulum.urdf"))
    q, rest = np.array([[0.0], [np.pi / 2], [1.0]]), np.zeros((3, 1))
    torque = pendulum.inverse_dynamics(q, rest, rest)
    np.testing.assert_allclose(torque, -2 * 9.81 * 0.5 * np.sin(q), atol=1e-9)
    np.testing.assert_allclose(pendulum.inertia_of(q, 0), 0.1 + 2 * 0.5**2)
    assert pendulum.flange_jacobian(q[0]).shape == (6, 1)


@pytest.mark.parametrize(
    ("given", "instead", "said"),
    [
        ('mass value="2"', 'mass value="nan"', "link 'arm': value of its mass is nan"),
        ('mass value="2"', 'mass value="two"', "link 'arm': value of its mass is two"),
        ('mass value="2"', 'mass value="-2"', "link 'arm': value of its mass is -2"),
        ('ixx="0.1"', 'ixx="inf"', "link 'arm': ixx of its inertia is inf"),
        ('xyz="0 0 0.5"', 'xyz="0 0 nan"', "link 'arm': xyz of its origin is nan"),
        ('upper="3"', 'upper="nan"', "joint 'hinge': upper of its limit is nan"),
        ('velocity="2"', 'velocity="1e999"', "joint 'hinge': velocity of its limit is 1e999"),
        ('velocity="2"', 'velocity="2" jerk="x"', "joint 'hinge': jerk of its limit is x"),
        ('velocity="2"', 'velocity="2" jerk="0"', "jerk of its limit is 0, expected .* above 0"),
    ],
)
def test_numbers_that_cannot_be_read_are_refused_by_name(tmp_path, given, instead, said):
    """The parser would leave out all inertias of such a file without a word."""
    (tmp_path / "arm.urdf").write_text(ONE_JOINT.replace(given, instead))
    with pytest.raises(ConfigError, match=said):
        RobotModel.load(tmp_path / "arm.urdf")


def test_a_jerk_that_is_stated_is_planned_with_and_kept(tmp_path):
    plain, stated = tmp_path / "plain.urdf", tmp_path / "stated.urdf"
    plain.write_text(ONE_JOINT)
    stated.write_text(ONE_JOINT.replace('velocity="2"', 'velocity="2" jerk="30"'))
    assert RobotModel.load(plain).jerk is None
    assert RobotModel.load(stated).limits.jerk == pytest.approx([30.0])
    for backend in ("virtual", "mujoco"):
        with open_robot(backend, robot=str(plain)) as robot:
            assert robot.spec.jerk is None
        with open_robot(backend, robot=str(stated)) as robot:
            assert robot.spec.jerk == pytest.approx([30.0])


def test_an_arm_without_inertias_moves_and_what_needs_torques_refuses_it_by_name(tmp_path):
    light = ONE_JOINT[: ONE_JOINT.index("<inertial>")] + ONE_JOINT[ONE_JOINT.index("</link>\n<j") :]
    (tmp_path / "light.urdf").write_text(light)
    said = "link arm, which joint hinge moves, has no mass"
    model = RobotModel.load(tmp_path / "light.urdf")
    assert model.massless == ("arm",)
    assert any(said in note for note in model.notes)
    model.check_runnable()
    assert model.flange_pose(np.zeros(1)).shape == (4, 4)
    for torques in (model.gravity_torque, model.mass_matrix):
        with pytest.raises(ConfigError, match=said):
            torques(np.zeros(1))
    heavy = Inertial(1.0, (0.0, 0.0, 0.5), (0.1, 0.0, 0.0, 0.1, 0.0, 0.1))
    assert model.with_inertials({"arm": heavy}).mass_matrix(np.zeros(1)) > 0
    for backend in ("virtual", "mujoco"):
        with pytest.raises(ConfigError, match=said):
            open_robot(backend, robot=str(tmp_path / "light.urdf"))
    with pytest.raises(ConfigError, match=said):
        ArmConfig(
            bus=Bus(interface="virtual", channel="light"),
            robot=str(tmp_path / "light.urdf"),
            joints=(Cia402Joint(node=1, counts_per_turn=4096, rated_torque=10.0),),
        )


def test_a_continuous_joint_counts_turns_and_is_moved_within_one(tmp_path):
    (tmp_path / "hinge.urdf").write_text(ONE_JOINT)
    text = ONE_JOINT.replace("revolute", "continuous").replace('lower="-3" upper="3" ', "")
    (tmp_path / "wheel.urdf").write_text(text)
    hinge, wheel = (RobotModel.load(tmp_path / f"{name}.urdf") for name in ("hinge", "wheel"))
    assert (hinge.turning, wheel.turning) == ((False,), (True,))
    assert wheel.limits.position_max == pytest.approx(np.pi)
    assert wheel.limits.velocity == hinge.limits.velocity
    assert wheel.whole_turns(np.array([20.0])) == pytest.approx(6 * np.pi)
    assert hinge.whole_turns(np.array([20.0])) == 0.0
    motion = np.random.default_rng(5).uniform(-2, 2, (3, 10, 1))
    turned = [motion[0] + 100 * 2 * np.pi, *motion[1:]]
    np.testing.assert_allclose(
        wheel.inverse_dynamics(*turned), hinge.inverse_dynamics(*motion), atol=1e-9
    )


def test_many_samples_have_the_torques_that_each_has_on_its_own(model, monkeypatch):
    motion = np.random.default_rng(3).uniform(-1, 1, (3, 3000, model.n))
    alone = np.concatenate([model.inverse_dynamics(*row[:, None]) for row in motion.swapaxes(0, 1)])
    for threads in ("1", "2", "", "all of them"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        fresh = RobotModel.load("iiwa14")
        np.testing.assert_allclose(fresh.inverse_dynamics(*motion), alone, atol=1e-12)


def test_a_model_that_was_used_is_sent_to_another_process_as_it_is():
    arm = RobotModel.load("iiwa14")
    many = np.linspace(-1.0, 1.0, 5000)[:, None] * np.ones(arm.n)
    torque = arm.inverse_dynamics(many, many, many)
    sent = deepcopy(arm)  # by what pickle asks, too
    np.testing.assert_array_equal(sent.inverse_dynamics(many, many, many), torque)


POSE = np.array([0.1, 0.5, -0.2, -1.0, 0.3, 0.8, 0.0])
WRENCH = np.array([10.0, -5.0, 20.0, 1.0, 2.0, -3.0])
STD = np.linspace(0.1, 0.5, 7)


@pytest.fixture(scope="module")
def arm():
    return RobotModel.load("iiwa14")


@pytest.mark.parametrize("frame", ["flange", "link7"])
def test_the_jacobian_is_the_velocity_of_the_frame_in_its_axes(arm, frame):
    found, step = FlangeWrench(arm, frame), 1e-6
    shift = arm.last_frames[frame]
    before = arm.joint_poses(POSE)[-1] @ shift
    for j in range(7):
        after = arm.joint_poses(POSE + step * np.eye(7)[j])[-1] @ shift
        moved = (np.linalg.inv(before) @ after - np.eye(4)) / step
        twist = [*moved[:3, 3], moved[2, 1], moved[0, 2], moved[1, 0]]
        np.testing.assert_allclose(found.jacobian(POSE)[:, j], twist, atol=1e-5)


def test_a_wrench_is_found_again(arm):
    found = FlangeWrench(arm)
    assert found.frame == "flange"
    for std in (STD, np.full(7, np.nan)):
        external = -found.jacobian(POSE).T @ WRENCH
        value, covariance = found.of(POSE, external, std)
        np.testing.assert_allclose(value, WRENCH, rtol=1e-4, atol=1e-3)
        assert np.isnan(covariance).all() == np.isnan(std).all()


def test_the_covariance_is_that_of_the_errors(arm):
    found, random = FlangeWrench(arm), np.random.default_rng(1)
    true = -found.jacobian(POSE).T @ WRENCH
    draws = np.array([
        found.of(POSE, true + STD * random.standard_normal(7), STD).value for _ in range(4000)
    ])  # fmt: skip
    stated = found.of(POSE, true, STD).covariance
    spread = np.linalg.solve(stated, np.cov(draws.T))
    np.testing.assert_allclose(np.linalg.eigvals(spread).real, 1.0, atol=0.15)


def test_what_no_joint_feels_is_unknown(arm):
    stretched = np.zeros(7)
    value, covariance = FlangeWrench(arm).of(stretched, np.zeros(7), STD)
    assert np.isfinite(value).all()
    assert np.sqrt(np.diag(covariance)).max() > 500.0


def test_a_frame_that_does_not_exist_is_refused_with_those_that_do(arm):
    with pytest.raises(ConfigError, match=r"no frame 'tool0' .* one of link7, flange$"):
        FlangeWrench(arm, "tool0")
