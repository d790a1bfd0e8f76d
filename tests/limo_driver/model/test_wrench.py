"""The wrench that explains external torques: found where it was, and as surely as stated."""

import numpy as np
import pytest

from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.kinematics import FlangeWrench

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
