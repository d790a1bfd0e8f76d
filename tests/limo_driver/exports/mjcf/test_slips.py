"""Slip elements in MJCF: plastic springs, which MuJoCo 4 steps alone as limo does."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import limo_driver as limo
from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.mjcf.joints import plastic_springs
from limo_driver.physics import CoulombFriction, PreslidingHysteresis, Simulation, SpringLoad
from limo_driver.physics.effect import JointMotion
from limo_driver.runtime.installed_mujoco import RELEASE

with_plasticity = pytest.mark.skipif(
    RELEASE[0] < 4, reason="needs MuJoCo 4: earlier ones have no plastic springs"
)
SLIPS = (
    PreslidingHysteresis(joint=1, stiffness=(300.0, 88.0, 25.0), width=(0.0017, 0.0052, 0.013)),
    PreslidingHysteresis(joint=2, stiffness=(40.0,), width=(0.01,)),
)
INTEGRATORS = ("Euler", "implicit", "implicitfast")
ARM = """<mujoco>
  <option timestep="{step}" integrator="{integrator}"/>
  {defaults}
  <worldbody>
    <body name="upper">
      <joint name="a" axis="0 1 0" range="-3 3" limited="true" ref="0.2" armature="0.05"
             damping="0.4"/>
      <inertial pos="0.2 0 0" mass="1.5" diaginertia="0.01 0.02 0.02"/>
      <body name="lower" pos="0.4 0 0">
        <joint name="b" axis="0 1 0" range="-3 3" limited="true" armature="0.02"{own}/>
        <inertial pos="0.15 0 0" mass="0.8" diaginertia="0.004 0.008 0.008"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="servo" joint="b" kp="60" kv="2"/></actuator>
  {more}
</mujoco>
"""
KEYS = '<keyframe><key name="home" qpos="-1 0.7"/><key qpos="0.5 -0.4"/></keyframe>'


@pytest.fixture
def arm(tmp_path):
    def write(more="", own="", defaults="", step=0.001, integrator="implicitfast"):
        path = tmp_path / "arm.xml"
        said = {"more": more, "own": own, "defaults": defaults}
        path.write_text(ARM.format(step=step, integrator=integrator, **said), "utf-8")
        return path

    return write


def exported(path, out, effects=SLIPS, **options):
    """Export effects into a file, beside what that states."""
    own = Simulation.load(path)
    others = tuple(x for x in own.effects if not isinstance(x, PreslidingHysteresis))
    return limo.export(replace(own, effects=(*others, *effects)), "mjcf", out, **options)


def stopped(data, memories):
    """Advance limo's own elements by a step of MuJoCo; return what they hold, (n,)."""
    held = np.zeros(2)
    for j, effect in enumerate(SLIPS):
        one = JointMotion(*(np.array([x]) for x in (data.time, data.qpos[j], data.qvel[j], 0, 0)))
        value, memories[j] = effect.advance(memories[j], one)
        held[j] = value[0]
    return held


@with_plasticity
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("step", [0.001, 0.002])
def test_plain_mujoco_moves_as_with_the_stop_operators_of_limo(arm, tmp_path, integrator, step):
    """One arm has the springs; its twin without them is held by what limo computes."""
    bare = arm(step=step, integrator=integrator)
    written = exported(bare, tmp_path / "out")
    assert written.share < 1e-3
    assert not written.remainder
    models = [mujoco.MjModel.from_xml_path(str(path)) for path in (written.file, bare)]
    own, twin = (mujoco.MjData(model) for model in models)
    memories, worst, apart = [effect.initial_state() for effect in SLIPS], 0.0, 0.0
    for k in range(int(4.0 / step)):
        drive = 9.0 * np.sin(4.0 * k * step) * np.cos(0.9 * k * step)
        for data in (own, twin):
            data.qfrc_applied[0], data.ctrl[0] = drive, 0.5 * np.sin(3.0 * k * step)
        held = stopped(twin, memories)
        twin.qfrc_applied[:] -= held
        mujoco.mj_step(models[0], own)
        mujoco.mj_step(models[1], twin)
        twin.qfrc_applied[:] = 0.0
        worst = max(worst, float(np.abs(own.qfrc_spring + held).max()))
        apart = max(apart, float(np.abs(own.qpos - twin.qpos).max()))
    assert worst < 1e-9  # [N m]
    assert apart < 1e-9  # [rad]
    assert np.ptp(twin.qpos) > 0.1


@with_plasticity
@pytest.mark.slow("writes five files, and has MuJoCo prove each")
def test_there_and_back_and_in_place(arm, tmp_path):
    first = exported(arm(), tmp_path / "first")
    assert first.needs.startswith("MuJoCo 4.0 or newer")
    assert '"MuJoCo": "4.0"' in first.diff
    read = Simulation.load(first.file)
    assert not any("tendon" in note for note in read.model.notes)
    again = [x for x in read.effects if isinstance(x, PreslidingHysteresis)]
    assert [(x.joint, x.stiffness, x.width) for x in again] == [
        (x.joint, x.stiffness, x.width) for x in SLIPS
    ]
    assert not limo.export(read, "mjcf", tmp_path / "same").diff
    softer = (replace(SLIPS[0], stiffness=(200.0,), width=(0.004,)), SLIPS[1])
    changed = exported(first.file, tmp_path / "changed", softer)
    model = mujoco.MjModel.from_xml_path(str(changed.file))
    assert {tuple(x[2:]) for x in plastic_springs(model)} == {(200.0, 0.004), (40.0, 0.01)}
    without = exported(first.file, tmp_path / "without", ())
    assert any("presliding hysteresis" in line for line in without.dropped)
    assert not mujoco.MjModel.from_xml_path(str(without.file)).ntendon


@with_plasticity
@pytest.mark.slow("writes two files, and has MuJoCo prove each")
def test_nothing_is_bent_where_mujoco_starts_nor_in_keyframes(arm, tmp_path):
    """With no rests in keyframes, the first step from `home` would have 400 N m."""
    first = exported(arm(KEYS), tmp_path / "first")
    harder = (*SLIPS, PreslidingHysteresis(joint=2, stiffness=(90.0,), width=(0.02,)))
    for file in (first.file, exported(first.file, tmp_path / "second", harder).file):
        model = mujoco.MjModel.from_xml_path(str(file))
        data = mujoco.MjData(model)
        assert model.nkey == 2
        for key in (None, 0, 1):
            mujoco.mj_resetData(model, data)
            if key is not None:
                mujoco.mj_resetDataKeyframe(model, data, key)
            mujoco.mj_forward(model, data)
            np.testing.assert_allclose(data.qfrc_spring, 0.0, atol=1e-9)
    assert model.nplastic == 10


@with_plasticity
def test_an_arm_without_an_actuator_has_springs_that_slip_too(arm, tmp_path):
    path = arm()
    text = path.read_text("utf-8")
    path.write_text(text[: text.index("<actuator>")] + "</mujoco>", "utf-8")
    written = exported(path, tmp_path / "out")
    found = [x for x in Simulation.load(written.file).effects if x.name == SLIPS[0].name]
    assert len(found) == len(SLIPS)
    assert written.remainder == ()


def test_mujoco_3_gets_one_bristle(arm, tmp_path):
    written = exported(arm(), tmp_path / "out", mujoco=3)
    assert written.needs == "MuJoCo 3.12 or newer"
    assert "springyield" not in written.diff
    assert [str(left).count("is written as LuGre friction") for left in written.remainder] == [1, 1]
    assert min(max(left.rms) for left in written.remainder) > 0.01  # [N m]


@with_plasticity
@pytest.mark.parametrize("integrator", ["RK4", "discrete"])
def test_where_plastic_springs_bend_within_a_step_there_is_a_bristle(arm, tmp_path, integrator):
    written = exported(arm(integrator=integrator), tmp_path / "out")
    assert "dcmotor" in written.diff
    assert "springyield" not in written.diff


@with_plasticity
def test_springs_of_users_are_read_and_what_others_count_on_stays(arm, tmp_path):
    more = (
        '<tendon><fixed name="mine" stiffness="100" springyield="0.02"><joint joint="a" coef="2"/>'
        '</fixed><fixed stiffness="7"><joint joint="a" coef="1"/></fixed></tendon>'
        '<sensor><tendonpos tendon="mine"/></sensor>'
    )
    own = ' stiffness="30" springyield="0.1"'
    defaults = '<default><tendon damping="3"/></default><compiler angle="radian"/>'
    read = Simulation.load(arm(more, own, defaults))
    assert not any(isinstance(effect, SpringLoad) for effect in read.effects)
    first, second = (x for x in read.effects if isinstance(x, PreslidingHysteresis))
    assert (first.joint, first.stiffness, first.width) == (1, (400.0,), (0.01,))
    assert (second.joint, second.stiffness, second.width) == (2, (30.0,), (0.1,))
    assert "not represented: 1 tendon" in read.model.notes
    written = exported(read.model.urdf, tmp_path / "out")
    model = mujoco.MjModel.from_xml_path(str(written.file))
    assert [x.stiffness for x in plastic_springs(model)] == [300.0, 88.0, 25.0, 40.0]
    assert model.tendon_stiffness[model.tendon("mine").id] == 0.0
    assert model.tendon_damping[model.tendon("a_slip_1").id] == 0.0
    assert model.nsensor == 1


@with_plasticity
def test_a_default_class_is_not_changed(arm, tmp_path):
    defaults = '<default><default class="s"><tendon springyield="0.02"/></default></default>'
    tendon = '<fixed class="s" stiffness="9"><joint joint="a" coef="1"/></fixed>'
    path = arm(f"<tendon>{tendon}</tendon>", defaults=defaults)
    none = (CoulombFriction(joint=1, tau_c=0.0, v_eps=0.01),)
    with pytest.raises(ConfigError, match="springyield of joint a has to change, but"):
        exported(path, tmp_path / "out", none)


@pytest.mark.skipif(RELEASE[0] > 3, reason="needs MuJoCo 3, which cannot prove a file for 4")
def test_what_the_installed_mujoco_cannot_prove_is_refused(arm, tmp_path):
    with pytest.raises(ConfigError, match="cannot be proven by the 3"):
        exported(arm(), tmp_path / "out", mujoco=4)


@pytest.mark.skipif(RELEASE[0] > 3, reason="needs MuJoCo 3, which has no plastic springs")
def test_a_file_for_mujoco_4_is_refused_with_what_it_needs(arm):
    with pytest.raises(ConfigError, match=r"it needs MuJoCo 4, 3\.\d+\.\d+ is installed"):
        Simulation.load(arm(own=' stiffness="30" springyield="0.1"'))


def test_there_are_two_releases(arm, tmp_path):
    with pytest.raises(ConfigError, match="`mujoco` is 5, expected 3 or 4"):
        exported(arm(), tmp_path / "out", mujoco=5)
