"""Descriptions of a real arm, in two formats: one robot."""

import os
from pathlib import Path

import numpy as np
import pytest

from limo_driver.model import RobotModel

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
ROBOT = DATA / "so101" / "robot"
STRANGERS = DATA / "stranger_logs"
OVERLOOKED = {
    "mjcf_comment_with_dashes/arm.xml": ("j1",),
    "negative_effort/arm.urdf": ("q1", "q2"),
    "urdf_axis_of_fixed_joint/arm.urdf": ("q1", "q2"),
}


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


@pytest.mark.skipif(not STRANGERS.is_dir(), reason="no logs of strangers; set LIMO_DATA")
@pytest.mark.parametrize("file", OVERLOOKED)
def test_what_other_readers_overlook_is_read(file):
    model = RobotModel.load(STRANGERS / file)
    assert model.joint_names == OVERLOOKED[file]
    assert np.isfinite(model.gravity_torque(np.zeros(model.n))).all()
    told = [note for note in model.notes if "effort=-1.0 of joint q1" in note]
    assert bool(told) == file.startswith("negative_effort")
