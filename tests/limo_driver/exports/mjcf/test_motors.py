"""LuGre friction and cogging in MJCF: DC motors without input, which MuJoCo steps alone."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mjcf_arms import arm_of

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.exports.servos import append_lines, write_motors
from limo_driver.exports.xml_edits import XmlText
from limo_driver.model.descriptions.description import JointDynamics, StatedBristles, StatedRipple
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation, TorqueRipple
from limo_driver.types import Motion

SERVOS = """  <actuator>
    <position name="servo" joint="hinge0" kp="100"/>
  </actuator>
</mujoco>"""
OF_JOINTS = r' (armature|damping|frictionloss|stiffness|springref)="[^"]*"'
RIPPLE = TorqueRipple(joint=2, cycles_per_rev=(6.0, 40.0), amplitude=(0.3, 0.1), phase=(0.4, 3.0))
BRISTLES = PreslidingHysteresis(
    joint=1, law="lugre", sigma_0=400.0, tau_c=1.0, sigma_1=2.0, tau_s=0.4, v_s=0.1
)
DAHL = PreslidingHysteresis(joint=3, law="dahl", sigma_0=200.0, tau_c=0.6)


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.xml"
    rigid = re.sub(OF_JOINTS, "", arm_of(3))  # what is written is all that its joints have
    path.write_text(rigid.replace("</mujoco>", SERVOS), "utf-8")
    return path


def with_effects(path, *effects):
    return replace(Simulation.load(path), effects=effects)


def slow(n, seconds=8.0, step=1e-3):
    """A slow motion with reversals."""
    time = np.arange(0, seconds, step)
    rate = 1.0 + 0.3 * np.arange(n)
    phase = np.outer(time, rate)
    return Motion(
        time, 0.5 * np.sin(phase), 0.5 * rate * np.cos(phase), -0.5 * rate**2 * np.sin(phase)
    )


def friction_in_mujoco(path, joints, motion):
    """What a plain stepping loop has to hold against the motors, (T, n)."""
    model = mujoco.MjModel.from_xml_path(str(path))
    own = [u for u in range(len(model.actuator_trntype)) if not model.actuator_ctrlnum[u]]
    model.opt.timestep = motion.time[1] - motion.time[0]
    data = mujoco.MjData(model)
    torque = np.zeros_like(motion.position)
    for k in range(len(torque)):
        for j, name in enumerate(joints):
            data.joint(name).qpos[0] = motion.position[k, j]
            data.joint(name).qvel[0] = motion.velocity[k, j]
        mujoco.mj_step(model, data)
        for u in own:
            name = model.joint(model.actuator_trnid[u][0]).name
            torque[k, joints.index(name)] -= data.actuator_force[u]
    return torque


def test_plain_mujoco_has_friction_with_memory_and_cogging(model, tmp_path):
    simulation = with_effects(model, BRISTLES, RIPPLE, DAHL)
    written = limo.export(simulation, "mjcf", tmp_path / "out")
    assert written.share < 0.01
    assert not written.remainder
    motion = slow(simulation.model.n)
    bare = replace(simulation, effects=())
    wanted = simulation.predict(motion) - bare.predict(motion)
    found = friction_in_mujoco(written.file, simulation.model.joint_names, motion)
    rms = np.sqrt(np.mean(wanted**2, axis=0))
    error = np.sqrt(np.mean((found - wanted) ** 2, axis=0))
    assert (error[:3] < 0.01 * rms[:3]).all()


@pytest.mark.slow("writes two files, and has MuJoCo prove one")
def test_slip_elements_are_one_bristle_that_leaves_little(model, tmp_path):
    slips = PreslidingHysteresis(
        joint=1, stiffness=(300.0, 88.0, 25.0), width=(0.0017, 0.0052, 0.013)
    )
    written = limo.export(with_effects(model, slips), "mjcf", tmp_path / "out", mujoco=3)
    assert written.share < 0.01
    (left,) = written.remainder
    height = float(np.dot(slips.stiffness, slips.width))
    assert "is written as LuGre friction" in str(left)
    assert max(left.rms) < 0.05 * height
    to_urdf = limo.export(with_effects(model, slips), "urdf", tmp_path / "urdf")
    assert max(left.rms) < 0.2 * max(to_urdf.remainder[0].rms)  # that has dry friction only


@pytest.mark.slow("writes four files, and has MuJoCo prove each")
def test_there_and_back_and_in_place(model, tmp_path):
    first = limo.export(with_effects(model, BRISTLES, RIPPLE, DAHL), "mjcf", tmp_path / "first")
    read = Simulation.load(first.file)
    motion = slow(read.model.n)
    wanted = with_effects(model, BRISTLES, RIPPLE, DAHL).predict(motion)
    np.testing.assert_allclose(read.predict(motion), wanted, atol=1e-6)
    assert not any("dynamics of" in note for note in read.model.notes)
    again = limo.export(read, "mjcf", tmp_path / "again")
    assert not again.diff
    softer = tuple(
        replace(e, sigma_0=300.0) if e.joints == (1,) else e for e in read.effects if e != RIPPLE
    )
    changed = limo.export(replace(read, effects=softer), "mjcf", tmp_path / "changed")
    lines = [line for line in changed.diff.splitlines() if line.startswith("+ ")]
    assert all("dcmotor" in line or "limo wrote" in line for line in lines)
    assert 'lugre="300 2 1 1.4 0.1"' in changed.diff
    smooth = TorqueRipple(joint=2, cycles_per_rev=(6.0,), amplitude=(0.0,), phase=(0.0,))
    none = (softer[0], smooth, CoulombFriction(joint=3, tau_c=0.0, v_eps=0.01))
    without = limo.export(replace(read, effects=none), "mjcf", tmp_path / "without")
    left = Simulation.load(without.file).effects
    assert [effect.joints for effect in left] == [(1,)]


@pytest.mark.slow("writes a file, and has MuJoCo prove it")
def test_controls_and_actuators_of_the_user_keep_their_numbers(model, tmp_path):
    before = mujoco.MjModel.from_xml_path(str(model))
    written = limo.export(with_effects(model, BRISTLES), "mjcf", tmp_path / "out")
    after = mujoco.MjModel.from_xml_path(str(written.file))
    assert after.nu == before.nu == 1
    assert after.actuator(0).name == "servo"


def test_a_default_class_is_not_changed(tmp_path):
    path = tmp_path / "model.xml"
    text = arm_of(2).replace(
        "<worldbody>",
        '<default><default class="m"><dcmotor input="none" resistance="1" motorconst="1e-6" '
        'lugre="9 0 1 1 0.1"/></default></default><worldbody>',
        1,
    )
    motor = '<actuator><dcmotor class="m" joint="hinge0"/></actuator></mujoco>'
    path.write_text(text.replace("</mujoco>", motor), "utf-8")
    read = Simulation.load(path)
    assert any(isinstance(effect, PreslidingHysteresis) for effect in read.effects)
    none = CoulombFriction(joint=1, tau_c=0.0, v_eps=0.01)
    with pytest.raises(ConfigError, match="stated in a default class"):
        limo.export(replace(read, effects=(none,)), "mjcf", tmp_path / "out")


MOTORS = """<mujoco>
  <actuator>
    <dcmotor name="mine" joint="a" input="none" resistance="2" lugre="300 1 0.5 0.6 0.1"/>
    <dcmotor name="a_cogging_1" joint="a" input="none" resistance="1" cogging="0.2 7 0.1"/>
    <dcmotor name="b_lugre" joint="b" input="none" resistance="1" lugre="90 0 0.3 0.3 0.1"/>
  </actuator>
  <actuator>
    <position name="servo" joint="a" kp="9"/>
  </actuator>
  <actuator/>
</mujoco>
"""
MINE, OTHER = StatedBristles(300.0, 1.0, 0.5, 0.6, 0.1), StatedBristles(200.0, 1.0, 0.4, 0.6, 0.1)
LINE = StatedRipple(0.2, 7.0, 0.1)


def edited(tmp_path, has, text=MOTORS):
    """Return the text in which joint a has other bristles or lines."""
    (path := tmp_path / "motors.xml").write_text(text, "utf-8")
    file = XmlText(path)
    stated = JointDynamics(bristles=(MINE,), ripples=(LINE,)) if text == MOTORS else JointDynamics()
    append_lines(file, "actuator", write_motors((file,), "a", stated, has, path))
    return file.text()


def test_only_the_motor_changes_whose_joint_has_other_numbers(tmp_path):
    same = edited(tmp_path, JointDynamics(bristles=(MINE,), ripples=(LINE,)))
    assert same == MOTORS
    softer = edited(tmp_path, JointDynamics(bristles=(OTHER,), ripples=(LINE,)))
    assert softer == MOTORS.replace("300 1 0.5", "200 1 0.4")


def test_a_motor_of_limo_goes_and_of_one_of_the_users_what_it_has_no_longer(tmp_path):
    gone = edited(tmp_path, JointDynamics())
    assert "a_cogging" not in gone
    assert 'name="mine" joint="a" input="none" resistance="2"/>' in gone
    assert 'name="b_lugre"' in gone


def test_new_motors_come_behind_all_actuators_whose_numbers_stay(tmp_path):
    lines = tuple(StatedRipple(0.1, cycles, 0.0) for cycles in (7.0, 14.0, 28.0))
    more = edited(tmp_path, JointDynamics(bristles=(MINE,), ripples=lines))
    names = re.findall(r'name="(\w+)"', more)
    assert names == ["mine", "a_cogging_1", "b_lugre", "servo", "a_cogging_2", "a_cogging_3"]
    assert [f'cogging="0.1 {cycles} 0"' in more for cycles in (7, 14, 28)] == [True] * 3
    filled = MOTORS.replace("  <actuator/>\n", "").replace('joint="a"', 'joint="c"')
    inside = edited(tmp_path, JointDynamics(bristles=(MINE,)), filled)
    assert inside.count("<actuator>") == filled.count("<actuator>") == 2
    assert inside.index('name="a_lugre"') > inside.index('name="servo"')
