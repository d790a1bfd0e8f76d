"""A robot in a recording is the one at hand by its joints, whatever its file is called."""

import re

import mujoco
import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

BODY = (
    '<inertial><origin xyz="0.02 0 0.15"/><mass value="2"/>'
    '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>'
)
LIMIT = '<limit lower="-2" upper="1.5" effort="40" velocity="2"/>'
URDF = f"""<robot name="arm">
  <link name="base"/><link name="upper">{BODY}</link><link name="fore">{BODY}</link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <origin xyz="0 0.1 0.3" rpy="0 0 0.4"/><axis xyz="0 1 0"/>{LIMIT}</joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4" rpy="0.2 0 0"/><axis xyz="1 0 0"/>{LIMIT}</joint>
</robot>
"""
OTHERS = {
    "a longer arm": ("0 0 0.4", "0 0 0.44"),
    "another axis": ("1 0 0", "0 1 0"),
    "the other direction": ('axis xyz="1', 'axis xyz="-1'),
    "another range": ('lower="-2"', 'lower="-1"'),
    "a slide": ('name="elbow" type="revolute"', 'name="elbow" type="prismatic"'),
}


@pytest.fixture
def recorded(tmp_path):
    """A recording beside the description that it names."""
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "arm.urdf").write_text(URDF)
    time = np.arange(300) * 0.01
    q = 0.5 * np.sin(np.outer(time, [2.0, 3.0]))
    recording = Recording(
        time, q, np.cos(q), robot="arm.urdf", source=str(tmp_path / "runs" / "log")
    )
    return tmp_path, recording


def test_a_copy_of_another_name_is_the_same_arm(recorded):
    folder, recording = recorded
    (folder / "copy.urdf").write_text(URDF.replace('mass value="2"', 'mass value="3"'))
    recording.check_robot(RobotModel.load(folder / "copy.urdf"))


def test_what_is_exported_or_saved_in_another_format_is_the_same_arm(recorded):
    folder, recording = recorded
    path = folder / "runs" / "arm.urdf"
    better = limo.export(Simulation(str(path)), "urdf", folder / "better.urdf").file
    mujoco.mj_saveLastXML(str(folder / "arm2.xml"), mujoco.MjModel.from_xml_path(str(path)))
    for other in (better, folder / "arm2.xml"):
        model = RobotModel.load(other)
        assert not model.name.endswith("arm.urdf")
        recording.check_robot(model)


@pytest.mark.parametrize("what", OTHERS)
def test_another_arm_is_not_and_neither_is_one_that_nobody_can_look_at(recorded, what):
    folder, recording = recorded
    given, instead = OTHERS[what]
    assert given in URDF
    (folder / "copy.urdf").write_text(
        re.sub(f"(?s)(.*){re.escape(given)}", rf"\g<1>{instead}", URDF)
    )
    with pytest.raises(RecordingError, match=r"is of robot arm\.urdf, expected"):
        recording.check_robot(RobotModel.load(folder / "copy.urdf"))
    (folder / "same.urdf").write_text(URDF)
    (folder / "runs" / "arm.urdf").unlink()
    with pytest.raises(RecordingError, match=r"is of robot arm\.urdf, expected"):
        recording.check_robot(RobotModel.load(folder / "same.urdf"))
