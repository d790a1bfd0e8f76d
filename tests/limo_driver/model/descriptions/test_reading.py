"""Descriptions of robots: MJCF means what MuJoCo makes of it, and bad ones end in one line."""

import re

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mjcf_arms import GRAVITY, arm_of, plain, torques

from estimators.diagnosis.from_torque.judgement.intervals import seen_by_sites
from limo_driver.app.library.inspecting import inspect
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.physics import Simulation, ViscousFriction
from limo_driver.robot.registry import open_robot
from limo_driver.types import Motion

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial></link>
  <link name="hand"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <link name="finger"><inertial><origin xyz="0 0 0.02"/><mass value="0.1"/>
    <inertia ixx="0.001" ixy="0" ixz="0" iyy="0.001" iyz="0" izz="0.001"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="40" velocity="2"/>
    <dynamics damping="0.7" friction="0.4"/></joint>
  <joint name="hand" type="revolute"><parent link="upper"/><child link="hand"/>
    <origin xyz="0 0 0.4"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2" effort="40" velocity="2"/></joint>
  <joint name="finger_slide" type="prismatic"><parent link="hand"/><child link="finger"/>
    <axis xyz="0 1 0"/><limit lower="0" upper="0.1" effort="5" velocity="1"/></joint>
</robot>
"""


@pytest.fixture
def file(tmp_path):
    """Write a description; returns its path."""

    def of(text, name="arm.xml"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    return of


def moved(n, T=40, seed=0):
    q, v, a = np.random.default_rng(seed).uniform(-1.5, 1.5, (3, T, n))
    return q, np.where(np.abs(v) < 0.1, 0.5, v), a


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(1, 7))
def test_a_made_up_arm_needs_the_torque_that_mujoco_says(tmp_path_factory, seed, joints):
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(arm_of(seed, joints))
    simulation = Simulation.load(path)
    q, v, a = moved(joints, seed=seed % 1000)
    expected = torques(plain(mujoco.MjModel.from_xml_path(str(path))), q, v, a)
    found = simulation.predict(Motion(np.arange(40.0), q, v, a))
    # dry friction is a constraint in MuJoCo, which may take a little less at its softest
    np.testing.assert_allclose(found, expected, atol=2e-3 * max(1.0, np.abs(expected).max()))


def test_what_the_file_states_becomes_effects(file):
    simulation = Simulation.load(file(arm_of(3)))
    of_first = {e.name: e for e in simulation.effects if e.joints == (1,)}
    assert set(of_first) == {"viscous_friction", "armature"}  # of the class
    assert of_first["armature"].inertia == pytest.approx(0.1)
    of_second = {e.name for e in simulation.effects if e.joints == (2,)}
    assert of_second >= {"coulomb_friction", "viscous_friction", "spring_load", "armature"} - {
        "armature"
    }
    assert simulation.model.gravity == pytest.approx(GRAVITY)


def test_a_sim_yaml_has_the_effects_of_its_robot_unless_it_states_some(file, tmp_path):
    file(arm_of(3))
    bare = tmp_path / "bare.yaml"
    bare.write_text("robot: arm.xml\n")
    none = tmp_path / "none.yaml"
    none.write_text("robot: arm.xml\neffects: []\n")
    assert Simulation.load(bare).effects == Simulation.load(tmp_path / "arm.xml").effects != ()
    assert Simulation.load(none).effects == ()


TIPPED = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/>
  <site name="camera" pos="0 .1 .1"/><site name="tcp" pos=".1 0 .3" euler="90 0 0"/>
</body></worldbody></mujoco>"""


def test_a_payload_may_be_stated_in_a_site_of_the_file(file, tmp_path):
    file(TIPPED, "arm.xml")
    path = tmp_path / "sim.yaml"
    load = "mass: 1.5, com: [0.01, 0.02, 0.03], inertia: [2.5e-3, 1e-4, 0, 2e-3, 0, 1e-3]"
    path.write_text(f"robot: arm.xml\neffects:\n- {{effect: payload, frame: tcp, {load}}}\n")
    (payload,) = Simulation.load(path).effects
    spec = mujoco.MjSpec.from_string(TIPPED)
    tool = spec.body("upper").add_body(name="tool", pos=[0.1, 0, 0.3], euler=[90, 0, 0])
    tool.explicitinertial, tool.mass, tool.ipos = True, 1.5, [0.01, 0.02, 0.03]
    tool.fullinertia = [2.5e-3, 2e-3, 1e-3, 1e-4, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    at = data.xipos[model.body("tool").id]
    np.testing.assert_allclose(payload.com, at, atol=1e-12)
    R = data.ximat[model.body("tool").id].reshape(3, 3)
    tensor = R @ np.diag(model.body_inertia[model.body("tool").id]) @ R.T
    np.testing.assert_allclose(payload.load.tensor(), tensor, atol=1e-12)
    path.write_text(
        "robot: arm.xml\neffects:\n- {effect: payload, frame: tip, mass: 1, com: [0, 0, 0]}\n"
    )
    with pytest.raises(ConfigError, match=r"frame is 'tip', expected .*camera.*tcp"):
        Simulation.load(path)


def test_a_payload_is_seen_from_the_sites_of_the_file(file):
    model = RobotModel.load(file(TIPPED, "arm.xml"))
    load = Inertial(1.0, (0.15, -0.02, 0.33), (0.0,) * 6)
    assert seen_by_sites(load, model) == (
        " Its centre is given in the frame of upper; it is at (0.150, -0.120, 0.230) m from the "
        "site camera and (0.050, 0.030, 0.020) m from the site tcp."
    )
    assert not seen_by_sites(load, RobotModel.load("iiwa14"))  # which has frames, and no sites


def test_dynamics_of_a_urdf_are_effects(file):
    found = Simulation.load(file(URDF, "arm.urdf"))
    assert ViscousFriction(joint=1, f_v=0.7) in found.effects
    assert found.effects[0].tau_c == 0.4
    assert {effect.joints for effect in found.effects} == {(1,)}


def test_bodies_without_inertia_have_that_of_their_shapes(file):
    path = file(arm_of(5, inertials=False))
    model = RobotModel.load(path)
    q, v, a = moved(4)
    data = plain(mujoco.MjModel.from_xml_path(str(path)))
    data.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data.dof_damping[:] = data.dof_armature[:] = data.jnt_stiffness[:] = 0
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), torques(data, q, v, a), atol=1e-8)


def test_links_and_joints_may_share_a_name_and_a_finger_is_locked_and_said_so(file):
    model = RobotModel.load(file(URDF, "arm.urdf"))
    assert model.joint_names == ("shoulder", "hand")
    assert model.notes[0].startswith("joint finger_slide, at the end of which none turns, is lock")


def test_a_slide_that_is_chosen_or_carries_the_arm_moves(file):
    path = file(URDF, "arm.urdf")
    chosen = RobotModel.load(f"{path}#*")
    assert chosen.joint_names == ("shoulder", "hand", "finger_slide")
    assert chosen.sliding == (False, False, True)
    assert "joint finger_slide slides: its positions are in m" in chosen.notes[-1]
    rail = URDF.replace('name="shoulder" type="revolute"', 'name="shoulder" type="prismatic"')
    assert RobotModel.load(file(rail, "rail.urdf")).sliding == (True, False)
    with_force = chosen.gravity_torque(np.array([[0.0, np.pi / 2, 0.0]]))
    assert with_force[0, 2] == pytest.approx(0.1 * 9.81)  # N, to hold the finger up


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ("", "joint finger, at the end of which none turns, is locked at 0"),
        ("#finger,wrist=0", "joint finger slides: its positions are in m"),
    ],
)
def test_an_inspection_says_what_becomes_of_a_slide(file, chosen, said):
    path = file(
        '<mujoco><worldbody><body name="a"><joint name="wrist" axis="0 1 0" range="-1 1"/>'
        '<geom size=".1" mass="1"/><body name="b" pos="0 0 .2"><joint name="finger" type="slide" '
        'range="0 .1"/><geom size=".02" mass=".2"/></body></body></worldbody></mujoco>',
        "arm.xml",
    )
    time = np.arange(0, 4, 0.004)
    q = 0.05 + 0.04 * np.sin(6 * time)
    found = inspect({"t": time, "q_m" if chosen else "q_rad": q, "tau": q}, f"{path}{chosen}")
    assert any(note.startswith(said) for note in found.notes())


def test_chosen_joints_move_and_all_others_are_locked_where_stated(file):
    path = file(URDF, "arm.urdf")
    one = RobotModel.load(f"{path}#should*,hand=0.5,finger_slide=0.05")
    both = RobotModel.load(path)
    assert one.joint_names == ("shoulder",)
    q = np.linspace(-1, 1, 9)[:, None]
    with_hand = np.column_stack([q, np.full(9, 0.5)])
    gravity = both.gravity_torque(with_hand)[:, :1]
    finger = one.gravity_torque(q) - gravity  # 0.1 kg moved by 5 cm, turned by 0.5 rad
    assert np.abs(finger).max() < 0.1 * 9.81 * 0.05 + 1e-9
    assert np.abs(finger).max() > 0.01
    assert "joint hand is locked at 0.5; what it carries is lumped" in one.notes
    assert one.inertials["upper"].mass == pytest.approx(3.1)


def test_a_joint_locked_beyond_its_range_is_said_with_that_range(file):
    path = file(URDF, "arm.urdf")
    (said, *_) = RobotModel.load(f"{path}#shoulder,hand=45").notes
    assert said.startswith("joint hand, whose range is ")
    assert said.endswith(" rad, is locked at 45; what it carries is lumped")


def test_an_arm_of_which_every_joint_is_locked_is_refused_with_their_names(file):
    path = file(URDF, "arm.urdf")
    with pytest.raises(ConfigError, match="shoulder, hand, finger_slide are locked, and none is"):
        RobotModel.load(f"{path}#shoulder,shoulder=0")


@pytest.mark.parametrize("place", ["nan", "-inf", "half", ""])
def test_a_joint_is_locked_at_a_finite_number_alone(file, place):
    path = file(URDF, "arm.urdf")
    with pytest.raises(ConfigError, match=f"hand is to be locked at '{place}', expected a finite"):
        RobotModel.load(f"{path}#shoulder,hand={place}")


def test_the_choice_of_joints_survives_a_sim_yaml(file, tmp_path):
    file(URDF, "arm.urdf")
    Simulation(f"{tmp_path}/arm.urdf#shoulder").save(tmp_path / "sim.yaml")
    assert "arm.urdf#shoulder" in (tmp_path / "sim.yaml").read_text()
    assert Simulation.load(tmp_path / "sim.yaml").model.joint_names == ("shoulder",)


def test_joints_that_follow_others_are_locked_where_those_put_them(file):
    mimic = '<axis xyz="0 1 0"/><mimic joint="hand" multiplier="0.1" offset="0.02"/>'
    at = URDF.rindex('<axis xyz="0 1 0"/>')
    text = URDF[:at] + mimic + URDF[at + len('<axis xyz="0 1 0"/>') :]
    model = RobotModel.load(file(text, "arm.urdf"))  # the hand leads a finger: a gripper's
    assert model.joint_names == ("shoulder",)
    model = RobotModel.load(f"{model.urdf}#shoulder,hand=0.5")
    assert "joint finger_slide, which follows hand, is locked at 0.07; what it" in model.notes[1]
    apart = RobotModel.load(f"{file(URDF, 'other.urdf')}#shoulder,hand=0.5,finger_slide=0.07")
    assert model.inertials == apart.inertials
    both = RobotModel.load(f"{model.urdf}#shoulder,hand")
    assert both.joint_names == ("shoulder", "hand")
    assert both.link_joints == ("shoulder", "hand", "finger_slide")


def test_a_mimic_that_names_no_joint_is_locked_and_said(file):
    at = URDF.rindex('<axis xyz="0 1 0"/>')
    text = URDF[:at] + "<mimic/>" + URDF[at:]
    model = RobotModel.load(file(text, "arm.urdf"))
    assert "finger_slide" not in model.joint_names
    (said,) = [note for note in model.notes if "mimic" in note]
    assert said.startswith("joint finger_slide, whose <mimic> names no joint, is locked at 0; what")


def test_limits_that_are_not_stated_are_named(file):
    model = RobotModel.load(file(arm_of(1)))
    assert model.notes[-1].endswith("state no velocity limit; 1 rad/s is taken")
    slide = URDF.replace('velocity="', 'velocity="0" was="')
    with_slide = RobotModel.load(f"{file(slide, 'slide.urdf')}#*")
    assert any("without one, the arm cannot be planned" in note for note in with_slide.notes)
    assert model.limits.torque.tolist() == [80.0] * 4


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><robot>&b;</robot>'
)
OUTSIDE = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/hostname">]><robot name="&e;"/>'
MOVING = (
    '<mujoco><worldbody><body name="trunk"><freejoint name="root"/><geom size="1"/>{}</body>'
    "</worldbody></mujoco>"
)
HINGE = '<body name="leg"><joint name="knee"/><geom size="1"/></body>'
FOOT = '<body name="foot"><joint name="ankle" type="ball"/><geom size="1"/></body></body>'
BALL = f"<mujoco><worldbody>{HINGE.replace('</body>', FOOT)}</worldbody></mujoco>"
REFUSED = [
    ("arm.urdf", BOMB, "declares the entity 'a'"),
    ("arm.urdf", OUTSIDE, "declares the entity 'e'"),
    ("arm.urdf", "<robot>" + "<a>" * 50_000 + "</a>" * 50_000 + "</robot>", "deeper than 500"),
    ("arm.xml", "<mujoco>" + "<a>" * 50_000 + "</a>" * 50_000 + "</mujoco>", "deeper than 500"),
    ("arm.xml", '<mujoco><include file="../../etc/passwd"/></mujoco>', "outside its folder"),
    (
        "arm.xml",
        """<mujoco><x y="<!--"/><include file="../../etc/passwd"/><x y="-->"/></mujoco>""",
        "is no XML",
    ),
    (
        "arm.xml",
        """<mujoco><x y="<?xml"/><include file="../../etc/passwd"/><x y="?>"/></mujoco>""",
        "is no XML",
    ),
    ("arm.xml", '<mujoco><include file="none.xml"/></mujoco>', "none.xml, which is not there"),
    (
        "arm.xml",
        '<mujoco><asset><model name="m" file="../../etc/arm.xml"/></asset><worldbody>'
        '<attach model="m" prefix="p_"/></worldbody></mujoco>',
        "includes ../../etc/arm.xml, which is outside its folder",
    ),
    ("arm.xml", "<mujoco><worldbody>", "is no XML"),
    (
        "arm.xml",
        '<mujoco><option apirate="1"/></mujoco>',
        "for another MuJoCo than [0-9.]+[?] That",
    ),
    ("arm.xml", "<html/>", "is neither URDF nor MJCF: its outermost element is <html>"),
    ("arm.xml", "<mujoco><worldbody/></mujoco>", "has no joint that turns"),
    ("arm.xml", BALL, "has the ball joint ankle, expected one axis a joint"),
    (
        "arm.xml",
        f"<mujoco><worldbody>{HINGE}{HINGE.replace('leg', 'arm').replace('knee', 'elbow')}"
        "</worldbody></mujoco>",
        "several arms of 1 hinges, leg, arm",
    ),
    (
        "arm.xml",
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody><body name="b">'
        '<joint/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>',
        "MuJoCo cannot compile it: .*gone.stl",
    ),
    ("arm.urdf", URDF.replace('link name="hand"', 'link name="upper"'), "more than one link"),
    (
        "arm.urdf",
        URDF.replace("prismatic", "Prismatic"),
        "of type 'Prismatic', expected one of rev",
    ),
    ("arm.urdf", URDF.replace('damping="0.7"', 'damping="much"'), "damping='much', expected"),
    ("arm.urdf", URDF.replace('joint name="hand"', "joint"), "has a joint without a name"),
    ("arm.urdf", URDF.replace("</robot>", '<link name="lost"/></robot>'), "has 2 links .* lost"),
    ("arm.urdf", re.sub("<parent link=[^>]*>", '<parent link="no"/>', URDF), "parent is the link"),
    (
        "arm.urdf",
        re.sub('<origin xyz="[^"]*"', '<origin xyz="0 0"', URDF, count=1),
        "xyz of its origin is 0 0, expected 3 numbers",
    ),
    ("arm.urdf", URDF.replace('"2"', '"${m}"'), r"has macros \(\${m}\): it is a xacro"),
    ("arm.urdf", re.sub('ixx="[^"]*"', 'ixx="-1"', URDF), "principal moments of inertia -1, "),
]


def test_an_arm_that_is_attached_is_read_from_beside_its_file_or_below(tmp_path):
    (tmp_path / "parts").mkdir()
    arm = f"<mujoco><worldbody>{HINGE}</worldbody></mujoco>"
    (tmp_path / "parts" / "arm.xml").write_text(arm, encoding="utf-8")
    cell = tmp_path / "cell.xml"
    cell.write_text(
        '<mujoco><asset><model name="m" file="parts/arm.xml"/></asset><worldbody>'
        '<attach model="m" body="leg" prefix="p_"/></worldbody></mujoco>',
        encoding="utf-8",
    )
    assert RobotModel.load(cell).joint_names == ("p_knee",)
    declared = f'<!DOCTYPE x [<!ENTITY a "aaaa">]>{arm}'
    (tmp_path / "parts" / "arm.xml").write_text(declared, encoding="utf-8")
    with pytest.raises(ConfigError, match="declares the entity"):
        RobotModel.load(cell)


def test_a_base_that_floats_stands_still(file):
    model = RobotModel.load(file(MOVING.format(HINGE)))
    assert model.joint_names == ("knee",)
    assert "the base is taken to stand still: root would let it float" in model.notes


def test_several_joints_of_one_body_move_one_after_the_other(file):
    """As MuJoCo moves them: the later about the axes that the earlier have turned."""
    joints = (
        '<joint name="lift" type="slide" axis="0 0 1"/>'
        '<joint name="yaw" axis="0 0 1" pos="0.1 0 0" ref="0.4"/>'
        '<joint name="roll" axis="1 0.2 0" pos="0 0.2 0.1"/>'
    )
    path = file(
        "<mujoco><compiler angle='radian'/><worldbody><body name='hip' pos='0 0.3 1' "
        f"euler='0.3 0.2 0'>{joints}<geom size='0.1' pos='0.1 0.2 0.3'/><body name='leg' "
        "pos='0 0 -0.4'><joint name='knee' axis='0 1 0'/><geom size='0.1' pos='0 0 -0.2'/>"
        "</body></body></worldbody></mujoco>"
    )
    model, own = RobotModel.load(path), mujoco.MjModel.from_xml_path(str(path))
    assert model.joint_names == ("lift", "yaw", "roll", "knee")
    q, v, a = moved(4)
    np.testing.assert_allclose(model.inverse_dynamics(q, v, a), torques(own, q, v, a), atol=1e-9)
    with open_robot("mujoco", robot=str(path)) as robot:
        held = model.gravity_torque(robot.receive().position)[0]
        np.testing.assert_allclose(robot.receive().torque, held, atol=1e-3)


def test_files_from_outside_a_folder_are_included_where_the_user_trusts_them(file, monkeypatch):
    arm = f"<mujoco><worldbody>{HINGE}</worldbody></mujoco>"
    scene = file("<mujoco><include file='../parts/arm.xml'/></mujoco>", "scenes/scene.xml")
    root = file(arm, "parts/arm.xml").parent.parent
    with pytest.raises(ConfigError, match="set LIMO_DESCRIPTIONS to a folder that holds both"):
        RobotModel.load(scene)
    monkeypatch.setenv("LIMO_DESCRIPTIONS", str(root / "scenes"))
    with pytest.raises(ConfigError, match="outside its folder"):
        RobotModel.load(scene)
    monkeypatch.setenv("LIMO_DESCRIPTIONS", str(root))
    assert RobotModel.load(scene).joint_names == ("knee",)


@pytest.mark.parametrize(("name", "text", "said"), REFUSED)
def test_bad_descriptions_end_in_one_line(file, name, text, said):
    path = file(text, name)
    with pytest.raises(ConfigError, match=said) as refused:
        RobotModel.load(path)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)


def test_the_nearest_body_is_taken_for_what_is_nearly_one(file):
    """As makers round them: one principal moment is a little above the sum of the others."""
    inertia = 'ixx="0.002" iyy="0.0085" izz="0.0107" ixy="0" ixz="0" iyz="0"'
    path = file(re.sub('ixx="[^>]*"', inertia, URDF, count=1), "arm.urdf")
    model = RobotModel.load(path)
    (link,) = [x for x, body in model.inertials.items() if abs(body.inertia[0] - 0.002) < 5e-4]
    body = model.inertials[link]
    assert body.is_consistent()
    np.testing.assert_allclose(np.diag(body.tensor()), (0.0021, 0.0086, 0.0107), atol=6e-5)
    (note,) = [x for x in model.notes if "principal moments" in x]
    assert f"link {link} has the principal moments of inertia 0.002, 0.0085, 0.0107 kg m²" in note
    assert "the nearest body that exists is taken" in note


THIN = {
    "rod": ("0.02", "0.02", "0"),
    "plate": ("0.02", "0.01", "0.01"),
    "point": ("0", "0", "0"),
    "slip of a sign": ("0.02", "0.03", "-0.004"),
}


@pytest.mark.parametrize("kind", THIN)
def test_links_as_thin_as_no_body_swing_as_their_mass_does(file, kind):
    """Rods and point masses of textbooks, and small moments with a wrong sign, are no refusal."""
    xx, yy, zz = THIN[kind]
    inertia = f'ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"'
    path = file(re.sub('ixx="[^>]*izz="0.01"', inertia, URDF, count=1), "arm.urdf")
    model = RobotModel.load(path)
    body = model.inertials["upper"]
    assert body.is_consistent() or kind == "plate"
    assert body.mass == 2.0
    torque = model.inverse_dynamics(np.zeros((1, 2)), np.zeros((1, 2)), np.array([[1.0, 0.0]]))
    load = model.inverse_dynamics(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2)))
    fore = 0.01 + 1.0 * 0.5**2 + 0.001 + 0.1 * 0.42**2  # with the finger, which is locked
    about = float(yy) + 2.0 * (0.1**2 + 0.2**2) + fore
    assert (torque - load)[0, 0] == pytest.approx(about, abs=3e-3)
    notes = [note for note in model.notes if "link upper" in note]
    assert len(notes) == (kind != "plate")
    assert ("body without any width" in " ".join(notes)) == (kind in {"rod", "point"})


def test_a_namespace_of_a_urdf_is_no_part_of_its_names(file):
    """As in files made for Drake, whose joints urdfdom and MuJoCo find all the same."""
    schema = '<robot xmlns="https://drake.mit.edu" xmlns:xi="x" name="arm">'
    text = URDF.replace('<robot name="arm">', schema)
    assert text != URDF
    plain, spaced = RobotModel.load(file(URDF, "a.urdf")), RobotModel.load(file(text, "b.urdf"))
    assert spaced.joint_names == plain.joint_names
    assert spaced.inertials == plain.inertials


def test_lost_meshes_and_ends_in_degrees_are_said_at_load(file):
    mesh = '<collision><geometry><mesh filename="package://arm/{}.stl"/></geometry></collision>'
    text = URDF.replace("</link>", f"{mesh.format('gone')}{mesh.format('here')}</link>", 1)
    text = re.sub('upper="[^"]*"', 'upper="170"', text)
    path = file(text, "arm.urdf")
    (path.parent / "arm").mkdir()
    (path.parent / "arm" / "here.stl").write_bytes(b"")
    model = RobotModel.load(path)
    notes = " ".join(model.notes)
    assert "reach 170 rad, 27 turns: are they in degrees?" in notes
    assert "not there: collision mesh package://arm/gone.stl;" in notes
    with pytest.raises(ConfigError, match=r"not there: collision mesh package://arm/gone\.stl$"):
        model.capsules()


@pytest.mark.parametrize("joints", ["elbow", "hand=x", "elbow=1"])
def test_joints_that_are_not_there_are_refused(file, joints):
    path = file(URDF, "arm.urdf")
    with pytest.raises(ConfigError, match=r"has no joint 'elbow'|locked at 'x'"):
        RobotModel.load(f"{path}#{joints}")


@pytest.mark.parametrize(
    ("part", "said"),
    [
        ('<geom name="g" size="0.1" mass="nan"/>', "body link: mass of its geom is nan"),
        ('<geom size="0.1" density="inf"/>', "body link: density of its geom is inf"),
        ('<inertial pos="0 nan 0" mass="1" diaginertia="1 1 1"/>', "pos of its inertial is nan"),
        ('<geom size="0.1" mass="1"/><joint name="b" armature="nan"/>', "armature of its joint"),
    ],
)
def test_a_number_of_an_mjcf_that_is_not_finite_is_refused_by_name(file, part, said):
    text = (
        f'<mujoco><worldbody><body name="link"><joint name="a"/>{part}</body></worldbody></mujoco>'
    )
    with pytest.raises(ConfigError, match=f"{said}.*, expected a finite number"):
        RobotModel.load(file(text))
