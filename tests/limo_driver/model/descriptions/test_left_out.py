"""What URDFs leave out: the ground, and ranges of joints."""

import re

import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel

INERTIA = '<inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>'
ARM = f"""<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>{INERTIA}</inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>{INERTIA}</inertial></link>
  <link name="left"><inertial><mass value="0.1"/>{INERTIA}</inertial></link>
  <link name="right"><inertial><mass value="0.1"/>{INERTIA}</inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="40" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="2"/></joint>
  <joint name="finger_left" type="prismatic"><parent link="fore"/><child link="left"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.04" effort="5" velocity="1"/></joint>
  <joint name="finger_right" type="prismatic"><parent link="fore"/><child link="right"/>
    <axis xyz="-1 0 0"/><limit lower="0" upper="0.04" effort="5" velocity="1"/>
    <mimic joint="finger_left"/></joint>
</robot>
"""
WELD = '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>'


@pytest.fixture
def file(tmp_path):
    def of(text, name="arm.urdf"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return of


def limited(joint, limits):
    """Return the arm with other limits of a joint."""
    pattern = f'(name="{joint}".*?)lower="[^"]*" upper="[^"]*"'
    return re.sub(pattern, rf"\g<1>{limits}", ARM, count=1, flags=re.DOTALL)


@pytest.mark.parametrize(
    "limits", ['lower="0" upper="0"', 'lower="0.0" upper="-0"', "", 'lower="9" upper="2"']
)
def test_limits_that_an_exporter_left_at_0_are_none(file, limits):
    """The joint turns on, and stands in no range of 0 to 0 that decides units or is kept to."""
    model = RobotModel.load(file(limited("shoulder", limits)))
    assert model.turning == (True, False)
    assert model.limits.position_min[0] < -3.0
    (note,) = [note for note in model.notes if "0 to 0" in note]
    assert note.startswith("the limits of shoulder are 0 to 0 or reversed, so none")
    with pytest.raises(ConfigError, match=r"the limits of shoulder are 0 to 0.*in the URDF"):
        model.check_runnable()
    with pytest.raises(ConfigError, match=r"the limits of shoulder are 0 to 0.*in the URDF"):
        limo.plan(model)


@pytest.mark.parametrize("limits", ['lower="0" upper="0.1"', 'lower="-0.1" upper="0"'])
def test_a_range_that_begins_or_ends_at_0_is_one(file, limits):
    model = RobotModel.load(file(limited("shoulder", limits)))
    assert model.turning == (False, False)
    assert not any("0 to 0" in note for note in model.notes)
    model.check_runnable()


def test_a_slide_without_a_range_gets_room_and_a_gripper_without_one_is_none_of_the_arms(file):
    text = limited("finger_left", 'lower="0" upper="0"')
    whole = RobotModel.load(file(text))
    assert whole.joint_names == ("shoulder", "elbow")
    assert not any("0 to 0" in note for note in whole.notes)
    whole.check_runnable()
    chosen = RobotModel.load(f"{file(text)}#shoulder,elbow,finger_left,finger_right=0")
    assert (chosen.limits.position_min[2], chosen.limits.position_max[2]) == (-1.0, 1.0)
    assert any("limits of finger_left are 0 to 0" in note for note in chosen.notes)


def test_a_follower_without_a_range_does_not_hold_its_leader(file):
    text = limited("finger_right", 'lower="0" upper="0"')
    model = RobotModel.load(f"{file(text)}#shoulder,elbow,finger_left")
    assert model.limits.position_max[2] == pytest.approx(0.04)
    assert not any("0 to 0" in note for note in model.notes)
    model.check_runnable()


@pytest.mark.parametrize(
    ("limits", "said"),
    [
        ('lower="" upper="0"', "lower of its limit is empty"),
        ('lower="0 0" upper="0"', "lower of its limit is 0 0"),
        ('lower="zero" upper="0"', "lower of its limit is zero"),
        ('lower="0" upper="nan"', "upper of its limit is nan"),
    ],
)
def test_a_limit_that_is_no_number_is_refused_by_name(file, limits, said):
    with pytest.raises(ConfigError, match=f"joint 'shoulder': {said}, expected a finite number"):
        RobotModel.load(file(limited("shoulder", limits)))


def test_the_ground_that_a_file_for_drake_leaves_out_is_taken(file):
    welded = ARM.replace("</robot>", f"{WELD}</robot>")
    model = RobotModel.load(file(welded))
    assert model.joint_names == RobotModel.load(file(ARM, "plain.urdf")).joint_names
    assert len([note for note in model.notes if "link world is not stated" in note]) == 1


OVERLOOKED = {
    "an axis of a joint that does not move": (WELD.replace("</j", '<axis xzy="0 0 1"/></j'), 1),
    "a base that floats": (WELD.replace("fixed", "floating"), 2),
    "what carries a part of a robot": (WELD.replace("world", "wall"), 1),
    "a prefix in what is Gazebo's": ("<gazebo><controller:plugin interface:x='1'/></gazebo>", 0),
    "dashes in a comment": ("<!-- arm -- of steel --->", 0),
    "a call of a macro that is nowhere": ('<xacro:camera name="a"/>', 1),
}


@pytest.mark.parametrize("what", OVERLOOKED)
def test_what_other_readers_overlook_changes_nothing_of_the_arm(file, what):
    more, notes = OVERLOOKED[what]
    plain = RobotModel.load(file(ARM, "plain.urdf"))
    model = RobotModel.load(file(ARM.replace("</robot>", f"{more}</robot>")))
    assert model.joint_names == plain.joint_names
    pose = np.array([[0.3, -0.4]])
    np.testing.assert_array_equal(model.gravity_torque(pose), plain.gravity_torque(pose))
    assert len(model.notes) == len(plain.notes) + notes


@pytest.mark.parametrize(
    ("given", "instead", "note"),
    [
        ("<robot", "<!-- made by hand -->\n<?xml version='1.0'?>\n<robot", ""),
        ("</robot>\n", "</robot>\0", ""),
        ('xyz="0.1 0 0.2"/>', "xyz='0.1 0 0.2'rpy=\"0 0 0\"/>", ""),
        ("</inertial>", "</inertial><xacro:grey/>", "does not define, grey"),
        ('<robot name="arm">', "<robot version='2'>", ""),
        ("</joint>", "<dynamics/><calibration rising='x'/><safety_controller/></joint>", ""),
        ('izz="0.01"', 'izz="0.01\n"', ""),
        ('ixy="0"', 'ixy="-1e-320"', ""),
        ('effort="40"', 'effort="-1.0"', "effort=-1.0 of joint shoulder"),
        ('effort="40"', 'effort="inf"', "effort=inf of joint shoulder"),
        ("</joint>", "<dynamics friction='-0.4'/></joint>", "friction=-0.4 of joint shoulder"),
        (' effort="40"', "", "joint shoulder states no effort limit"),
        (re.search("<limit[^>]*>", ARM)[0], "", "limits of shoulder are 0 to 0"),
    ],
)
def test_what_other_readers_take_for_the_same_is_the_same(file, given, instead, note):
    plain = RobotModel.load(file(ARM, "plain.urdf"))
    model = RobotModel.load(file(ARM.replace(given, instead, 1)))
    assert model.inertials == plain.inertials
    assert model.joint_names == plain.joint_names
    assert note in " ".join(model.notes)


def test_a_joint_that_turns_about_no_one_axis_is_locked_and_told(file):
    ball = ARM.replace("</robot>", """<link name="ball"/><joint name="neck" type="spherical">
        <parent link="{}"/><child link="ball"/></joint></robot>""".format(
            re.findall('<link name="([^"]*)"', ARM)[-1]))  # fmt: skip
    model = RobotModel.load(file(ball))
    assert model.joint_names == RobotModel.load(file(ARM, "plain.urdf")).joint_names
    assert "turn about no one axis: neck" in " ".join(model.notes)


@pytest.mark.parametrize("encoding", ["iso-8859-1", "windows-1252", "utf-16"])
def test_text_is_read_in_the_encoding_that_it_declares(file, tmp_path, encoding):
    text = ARM.replace('name="arm"', 'name="bras de Zoé"').replace("shoulder", "épaule")
    path = file("")
    path.write_bytes(f"<?xml version='1.0' encoding='{encoding}'?>\n{text}".encode(encoding))
    assert "épaule" in RobotModel.load(path).joint_names
    with pytest.raises(ConfigError, match="no text of UTF-8; save it as such"):
        limo.export(limo.nominal(str(path)), "urdf", tmp_path / "out")


def test_bytes_in_no_stated_encoding_are_refused(file):
    path = file("")
    path.write_bytes(ARM.replace('name="arm"', 'name="Zoé"').encode("latin-1"))
    with pytest.raises(ConfigError, match="no text of UTF-8"):
        RobotModel.load(path)


def test_frames_between_axes_need_no_mass_and_links_with_a_shape_do(file):
    light = re.sub(r"<inertial><origin xyz=.0.1.*?</inertial>", "", ARM, count=1)
    framed = RobotModel.load(file(light))
    shape = "<visual><geometry><sphere radius='1'/></geometry></visual>"
    assert framed.massless == ()
    assert np.isfinite(framed.gravity_torque(np.zeros(2))).all()
    shaped = light.replace('<link name="upper">', f'<link name="upper">{shape}')
    assert RobotModel.load(file(shaped, "shaped.urdf")).massless == ("upper",)


def test_an_export_changes_nothing_of_what_is_left_out(file, tmp_path):
    text = limited("shoulder", 'lower="0" upper="0"').replace("</robot>", f"{WELD}</robot>")
    path = file(text)
    found = limo.export(limo.nominal(str(path)), "urdf", tmp_path / "out")
    assert found.diff == ""
    assert found.file.read_text(encoding="utf-8") == text
    assert found.share < 1e-6
