"""Joints that follow others: rigid body, regressor, kinematics and limits of the reduced joints."""

import numpy as np
import pytest
from linked_arms import OFFSET, RATIO, gripper, parallelogram, torque_of_tree

from estimators.rigid_body.base_parameters import Conditioning
from estimators.rigid_body.regressor import RegressorChain, link_parameters, parameters_of
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.kinematics import KinematicChain
from limo_driver.physics.described import described_effects
from limo_driver.types import Motion

FINGERS = "yaw,shoulder,elbow,finger_b"


@pytest.fixture(params=["gripper", "parallelogram"])
def arm(request, tmp_path):
    """An arm, the URDF of its tree and how joints follow in it."""
    if request.param == "gripper":
        (tmp_path / "gripper.urdf").write_text(gripper(), encoding="utf-8")
        model = RobotModel.load(f"{tmp_path / 'gripper.urdf'}#{FINGERS}")
        return model, gripper(), {"finger_a": ("finger_b", RATIO, OFFSET)}
    (tmp_path / "linkage.xml").write_text(parallelogram(), encoding="utf-8")
    model = RobotModel.load(tmp_path / "linkage.xml")
    return model, model.description.text, {"level": ("shoulder", -1.0, 0.1)}


@pytest.fixture
def motion(arm):
    q, v, a = np.random.default_rng(0).uniform(-0.8, 0.8, (3, 40, arm[0].n))
    return Motion(np.arange(40.0), q, v, a)


def test_torque_is_that_of_the_tree_whose_joints_are_held_together(arm, motion):
    model, text, followers = arm
    assert model.linkage.links == model.n + 1
    assert not set(followers) & set(model.joint_names)
    of = (motion.position, motion.velocity, motion.acceleration)
    wanted = torque_of_tree(text, followers, *of)
    np.testing.assert_allclose(model.inverse_dynamics(*of), wanted, atol=1e-10)
    chain = RegressorChain.of(model)
    phi = np.concatenate([parameters_of(model.inertials[link]) for link in model.link_names])
    np.testing.assert_allclose((chain.regressor(motion) @ phi).T, wanted, atol=1e-10)
    M = model.mass_matrix(motion.position[0])
    np.testing.assert_allclose(M[:, 1], model.inertia_of(motion.position, 1)[0], atol=1e-10)


def test_kinematics_are_those_of_the_links(arm, motion):
    model = arm[0]
    chain = KinematicChain.of(model)
    expected = [model.joint_poses(q) for q in motion.position]
    np.testing.assert_allclose(chain.joint_poses(motion.position), expected, atol=1e-10)
    q, step = motion.position[0], 1e-6 * np.eye(model.n)
    rates = [model.flange_position(q + d) - model.flange_position(q - d) for d in step]
    J = np.concatenate(rates).T / 2e-6
    np.testing.assert_allclose(model.flange_jacobian(q)[:3], J, atol=1e-7)


def test_the_derivative_of_the_condition_number_is_that_of_its_differences(arm, motion):
    conditioning = Conditioning(arm[0])
    found = conditioning.smooth(motion, 8.0)
    for name in ("position", "velocity", "acceleration"):
        for j in range(arm[0].n):
            values = []
            for step in (1e-5, -1e-5):
                moved = getattr(motion, name).copy()
                moved[3, j] += step
                parts = {"position": motion.position, "velocity": motion.velocity}
                parts |= {"acceleration": motion.acceleration, name: moved}
                values.append(conditioning.smooth(Motion(motion.time, **parts), 8.0).value)
            slope = (values[0] - values[1]) / 2e-5
            assert getattr(found, name)[3, j] == pytest.approx(slope, abs=2e-3)


def test_a_joint_keeps_within_the_limits_of_what_follows_it(tmp_path):
    (tmp_path / "gripper.urdf").write_text(gripper(), encoding="utf-8")
    model = RobotModel.load(f"{tmp_path / 'gripper.urdf'}#{FINGERS}")
    assert model.limits.position_min[3] == 0.0
    assert model.limits.position_max[3] == pytest.approx((-0.07 - OFFSET) / RATIO)
    assert f"joint finger_a follows finger_b: {RATIO} times its position + {OFFSET}" in model.notes
    assert RobotModel.load(tmp_path / "gripper.urdf").joint_names == ("yaw", "shoulder", "elbow")


def test_what_follows_is_felt_where_it_follows(tmp_path):
    with_own = gripper('<dynamics friction="0.5" damping="2"/>')
    (tmp_path / "gripper.urdf").write_text(with_own, encoding="utf-8")
    model = RobotModel.load(f"{tmp_path / 'gripper.urdf'}#{FINGERS}")
    dry, viscous = described_effects(model)
    assert (dry.joint, dry.tau_c) == (4, pytest.approx(0.5 * abs(RATIO)))
    assert (viscous.joint, viscous.f_v) == (4, pytest.approx(2 * RATIO**2))


def test_what_is_not_felt_of_what_follows_is_said(tmp_path):
    (tmp_path / "arm.xml").write_text(parallelogram(' stiffness="3"'), encoding="utf-8")
    notes = RobotModel.load(tmp_path / "arm.xml").notes
    assert "not represented: spring of joint level, which follows shoulder" in notes


@pytest.mark.parametrize(
    ("joints", "change", "expected"),
    [
        ("yaw,finger_a", ("", ""), "finger_a follows finger_b, which is not chosen: choose fin"),
        ("*", ('joint="finger_b"', 'joint="finger_a"'), "finger_a follows itself, by way of"),
        ("*", ('lower="-0.07"', 'lower="0.04"'), "no position of that at which both are within"),
        ("*", ('multiplier="-0.8"', 'multiplier="nan"'), "has multiplier='nan', expected a fin"),
    ],
)
def test_what_cannot_follow_is_refused_in_one_line(tmp_path, joints, change, expected):
    (tmp_path / "arm.urdf").write_text(gripper().replace(*change), encoding="utf-8")
    with pytest.raises(ConfigError, match=expected) as refused:
        RobotModel.load(f"{tmp_path / 'arm.urdf'}#{joints}")
    assert "\n" not in str(refused.value)


def test_a_joint_that_follows_one_which_it_carries_is_refused(tmp_path):
    turned = parallelogram().replace('joint1="level" joint2="shoulder"', 'joint1="shoulder"')
    turned = turned.replace('joint1="shoulder"', 'joint1="shoulder" joint2="level"')
    (tmp_path / "arm.xml").write_text(turned, encoding="utf-8")
    with pytest.raises(ConfigError, match="shoulder follows level, which it carries: let that"):
        RobotModel.load(tmp_path / "arm.xml")


def test_equalities_that_are_no_line_are_said_to_be_left_aside(tmp_path):
    bent = parallelogram().replace('polycoef="0.1 -1 0', 'polycoef="0.1 -1 0.2')
    (tmp_path / "arm.xml").write_text(bent, encoding="utf-8")
    model = RobotModel.load(tmp_path / "arm.xml")
    assert model.n == 4
    assert "not represented: 1 equality constraint" in model.notes


def test_what_needs_joints_in_series_says_so(arm):
    with pytest.raises(ConfigError, match="has joints that follow others, with which this cannot"):
        link_parameters(arm[0])
