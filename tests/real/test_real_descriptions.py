"""Descriptions of a real arm, in two formats: one robot."""

import os
from pathlib import Path

import numpy as np
import pytest

from limo_driver.model import RobotModel

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
ROBOT = DATA / "so101" / "robot"


@pytest.mark.slow("identifies an arm of servos")
@pytest.mark.skipif(not ROBOT.is_dir(), reason="no SO-101; set LIMO_DATA")
def test_a_servo_arm_is_the_same_from_either_file():
    """Body and joint of its gripper share a name; its URDF has meshes, its MJCF classes."""
    mjcf, urdf = (RobotModel.load(ROBOT / f"so101_new_calib.{end}") for end in ("xml", "urdf"))
    q, v, a = np.random.default_rng(0).uniform(-1, 1, (3, 50, 6))
    found = mjcf.inverse_dynamics(q, v, a) - urdf.inverse_dynamics(q, v, a)
    assert np.abs(found).max() < 1e-4  # the files round differently
    assert mjcf.joint_names == urdf.joint_names
    assert mjcf.description.dynamics["elbow_flex"].damping == 0.6
