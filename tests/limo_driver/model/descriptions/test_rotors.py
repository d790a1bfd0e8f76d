"""Inertia of drives that a description has in its links."""

import re

import numpy as np
import pytest

import limo_driver as limo
from limo_driver import nominal
from limo_driver.model import RobotModel
from limo_driver.physics import Armature
from limo_driver.types import Motion

ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.02 0 0.2" rpy="0 0.3 0"/><mass value="3"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="1.5" iyz="0" izz="0.01"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.004"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="40" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="2"/></joint>
</robot>
"""


@pytest.fixture
def file(tmp_path):
    def of(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text, encoding="utf-8")
        return path

    return of


def test_what_no_link_has_about_the_axis_of_its_joint_is_the_drives(file):
    path = file(ARM)
    model, simulation = RobotModel.load(path), nominal(str(path))
    (drive,) = [effect for effect in simulation.effects if isinstance(effect, Armature)]
    assert (drive.joint, drive.inertia) == (1, pytest.approx(1.5 - 0.03))
    assert model.inertials["upper"].is_consistent()
    np.testing.assert_allclose(np.diag(model.inertials["upper"].tensor())[1], 0.03, rtol=1e-3)
    (note,) = [x for x in model.notes if "armature" in x]
    assert "link upper has 1.5 kg m² about the axis of joint shoulder" in note
    assert not any("principal moments" in x for x in model.notes)


def test_the_torque_about_that_axis_is_that_of_the_file(file):
    """As the file has it, while nothing turns the link about another axis."""
    simulation = nominal(str(file(ARM)))
    zero = np.zeros((1, 2))
    resting = simulation.predict(Motion(np.zeros(1), zero, zero, zero))
    turning = simulation.predict(Motion(np.zeros(1), zero, zero, np.array([[1.0, 0.0]])))
    upper = 1.5 + 3.0 * (0.02**2 + 0.2**2)
    fore = 0.01 + 1.0 * 0.5**2
    assert float((turning - resting)[0, 0]) == pytest.approx(upper + fore, rel=1e-3)


@pytest.mark.parametrize("inertia", ['ixx="1.5"', 'izz="1.5"'])
def test_what_a_link_has_about_another_axis_is_no_drives(file, inertia):
    name = inertia[:3]
    text = ARM.replace('iyy="1.5"', 'iyy="0.02"')
    text = re.sub(f'{name}="[^"]*"', inertia, text, count=1)
    expect_the_nearest_body(file(text))


def expect_the_nearest_body(path):
    """Of link upper, whose mass and centre of mass stay, and no inertia of a drive."""
    model = RobotModel.load(path)
    assert model.inertials["upper"].is_consistent()
    assert model.inertials["upper"].mass == 3.0
    assert not nominal(str(path)).effects
    (note,) = [x for x in model.notes if "principal moments" in x]
    assert "link upper" in note
    assert "1.5 kg m²" in note
    assert note.endswith("is it a mistake in the file?")


def test_a_drive_of_a_follower_is_felt_at_the_joint_that_it_follows(file):
    text = ARM.replace('<parent link="base"/>', '<parent link="fore"/>')
    text = text.replace('<parent link="upper"/>', '<parent link="base"/>')
    text = text.replace(
        '<axis xyz="0 1 0"/>', '<mimic joint="elbow" multiplier="2"/><axis xyz="0 1 0"/>'
    )
    simulation = nominal(str(file(text)))
    assert simulation.model.joint_names == ("elbow",)
    (drive,) = [x for x in simulation.effects if isinstance(x, Armature)]
    assert (drive.joint, drive.inertia) == (1, pytest.approx(4.0 * (1.5 - 0.03)))


def test_a_slide_has_no_inertia_of_a_drive_about_it(file):
    text = ARM.replace('name="shoulder" type="revolute"', 'name="shoulder" type="prismatic"')
    expect_the_nearest_body(file(text))


@pytest.mark.parametrize("kind", ["drake", "isaaclab"])
def test_an_export_has_it_once_beside_the_link(file, tmp_path, kind):
    """A link of the file still had it: its reader would add the rotor to that."""
    found = limo.export(nominal(str(file(ARM))), kind, tmp_path / "out")
    assert found.share < 1e-6
    assert found.remainder == ()
    again = RobotModel.load(found.file)
    np.testing.assert_allclose(np.diag(again.inertials["upper"].tensor())[1], 0.03, rtol=1e-3)
    assert not any("armature" in note for note in again.notes)


def test_an_export_without_numbers_for_drives_says_what_it_leaves_out(file, tmp_path):
    found = limo.export(nominal(str(file(ARM))), "urdf", tmp_path / "out")
    assert [str(left).split(":")[0] for left in found.remainder] == [
        "armature, joint 1 is not expressible"
    ]
    assert found.share < 1e-6
