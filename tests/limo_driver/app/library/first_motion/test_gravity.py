"""Which single mistake explains torques at rest."""

import re
from itertools import combinations

import numpy as np
import pytest

from limo_driver.app.library.first_motion.gravity import TOLERANCE, StillPose, judge_gravity
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import GravityDirection, Payload, Simulation
from limo_driver.robot.registry import Examination

ARM = RobotModel.load("iiwa14")
WITHIN = TOLERANCE * ARM.limits.torque
POSES = np.array(
    [
        [0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0],
        [0.4, -0.6, 0.5, 1.0, -0.6, -0.7, 0.8],
        [-0.5, 0.8, -0.7, -0.9, 0.9, 1.1, -0.6],
    ]
)


def judged(position, torque, model=ARM, noise=0.1):
    """Judge torques with errors of sensors."""
    random = np.random.default_rng(1)
    read = torque + noise * WITHIN * random.uniform(-1.0, 1.0, torque.shape)
    return judge_gravity(
        model, [StillPose(*each) for each in zip(position, read, strict=True)], WITHIN
    )


def loaded(effect):
    return Simulation("iiwa14", effects=(effect,)).body.gravity_torque(POSES)


def test_an_arm_as_described_fits_with_sensors_at_their_tolerance():
    found = judged(POSES, ARM.gravity_torque(POSES), noise=1.0)
    assert found.fits
    assert found.causes == ()


@pytest.mark.parametrize("mass", [2.0, 5.0])
def test_a_tool_that_is_not_described_is_weighed(mass):
    found = judged(POSES, loaded(Payload(mass=mass, com=(0.0, 0.02, 0.12))))
    assert [each.kind for each in found.causes] == ["tool-mass"]
    assert f"{mass:.0f} kg more" in found.causes[0].text


def test_a_tool_that_is_described_and_not_mounted_is_told_as_less():
    laden = Simulation("iiwa14", effects=(Payload(mass=3.0, com=(0.0, 0.0, 0.1)),)).body
    found = judged(POSES, ARM.gravity_torque(POSES), laden)
    assert [each.kind for each in found.causes] == ["tool-mass"]
    assert "kg less" in found.causes[0].text


@pytest.mark.parametrize(
    ("gravity", "along"),
    [((9.81, 0.0, 0.0), "+x"), ((-9.81, 0.0, 0.0), "-x"), ((0.0, 9.81, 0.0), "+y")],
)
def test_a_base_turned_by_a_right_angle_is_named_with_the_angle(gravity, along):
    first, *_ = judged(POSES, loaded(GravityDirection(gravity=gravity))).causes
    assert first.kind == "mounting"
    assert f"along {along} " in first.text
    assert first.text.endswith("turned by 90°")


def test_a_base_that_stands_askew_is_named():
    first, *_ = judged(POSES, loaded(GravityDirection(gravity=(3.0, 0.0, -9.34)))).causes
    assert first.kind == "mounting"
    assert "turned by 18°" in first.text


def test_what_fits_as_well_is_said_too():
    kinds = {each.kind for each in judged(POSES, -ARM.gravity_torque(POSES)).causes}
    assert {"sign", "mounting"} <= kinds  # an arm upside down has the same torques


@pytest.mark.parametrize("pair", list(combinations(range(7), 2)))
def test_exchanged_joints_are_named_or_listed_as_unseen(pair):
    order = np.arange(7)
    order[list(pair)] = order[list(pair[::-1])]
    found = judged(POSES[:, order], ARM.gravity_torque(POSES)[:, order])
    words = f"joints {pair[0] + 1} and {pair[1] + 1}"
    if found.fits:
        assert f"{words} exchanged" in found.unseen
        return
    first, *_ = found.causes
    assert first.kind == "exchanged-joints"
    assert words in first.text or f"{words} exchanged" in found.unseen


@pytest.mark.parametrize("joint", range(1, 8))
def test_offsets_of_sensors_are_named_with_their_size(joint):
    torque = ARM.gravity_torque(POSES)
    torque[:, joint - 1] += 3.0 * WITHIN[joint - 1]
    first, *_ = judged(POSES, torque).causes
    assert first.kind == "sensor-offset"
    assert f"joint {joint} by +{3.0 * WITHIN[joint - 1]:.2g}"[:-1] in first.text


def test_drives_without_torque_are_named():
    (only,) = judged(POSES, np.zeros_like(POSES), noise=0.0).causes
    assert only.kind == "no-torque"


def test_two_mistakes_at_once_are_not_explained_by_one():
    torque = loaded(Payload(mass=4.0, com=(0.0, 0.02, 0.12)))
    torque[:, 0] += 40.0
    torque[:, 3] *= -1.0
    found = judged(POSES, torque)
    assert not found.fits
    assert found.causes == ()


def test_what_no_pose_can_show_is_listed():
    upright = np.zeros((3, 7)) + 0.01 * np.arange(3)[:, None]
    found = judged(upright, ARM.gravity_torque(upright))
    assert "joints 2 and 4 exchanged" in found.unseen
    assert found.lightest > judged(POSES, ARM.gravity_torque(POSES)).lightest
    assert [each.split()[3] for each in found.unseen_mounting] == ["+y", "-y", "+z"]


@pytest.mark.parametrize(
    ("pose", "tool"), [(POSES, "kg more or less"), (0 * POSES, "no tool at all")]
)
def test_the_tool_that_would_have_shown_is_one_that_there_is(pose, tool):
    said = Examination()
    judged(pose, ARM.gravity_torque(pose)).judge(said, TOLERANCE)
    text = said.findings[-1].text
    assert tool in text
    assert re.search(
        r", and not joints 1 and [23] exchanged, .* and \d+ more$", text
    )  # on the page, all


def test_poses_that_bend_the_arm_aside_show_every_mounting():
    assert judged(POSES, ARM.gravity_torque(POSES)).unseen_mounting == ()


def test_arms_without_masses_are_refused(tmp_path):
    file = tmp_path / "light.urdf"
    file.write_text(
        '<robot name="light"><link name="base"/><link name="one"/><joint name="a" type="revolute">'
        '<parent link="base"/><child link="one"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>'
    )
    with pytest.raises(ConfigError, match="no mass"):
        judge_gravity(RobotModel.load(file), [StillPose(np.zeros(1), np.zeros(1))], np.ones(1))
