"""Backlash as MuJoCo's users write it: a narrow hinge without an actuator beside the joint's."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

import limo_driver as limo
from limo_driver.physics import Armature, Backlash, Simulation

GAP = 0.02
PLAY = '<joint name="slack" axis="0 1 0" range="-.01 .01"/>'
ARM = """<mujoco><compiler angle="radian"/>
<option timestep="0.001" integrator="implicitfast"/><worldbody>
<body name="upper">
  <joint name="shoulder" axis="0 1 0" range="-2 2" armature="0.05"/>%s
  <geom type="capsule" fromto="0 0 0 0 0 .3" size=".05" mass="3" contype="0" conaffinity="0"/>
  <body name="lower" pos="0 0 .3">
    <joint name="elbow" axis="0 1 0" range="-2 2"/>
    <geom type="capsule" fromto="0 0 0 0 0 .2" size=".04" mass="1" contype="0" conaffinity="0"/>
  </body>
</body></worldbody>
<actuator><position joint="shoulder" kp="4000" kv="60"/><position joint="elbow" kp="200" kv="4"/>
</actuator>%s</mujoco>
"""


@pytest.fixture
def arm(tmp_path):
    """Write an arm, with what stands beside its first joint, and at the end of the file."""

    def of(play="", more=""):
        path = tmp_path / "arm.xml"
        path.write_text(ARM % (play, more), encoding="utf-8")
        return path

    return of


def with_play(path, *, armature=0.05, joint=1):
    found = [Backlash(joint=joint, gap=GAP)]
    if armature:
        found.append(Armature(joint=joint, inertia=armature))
    return Simulation(str(path), tuple(found))


def settled(path, shoulder):
    """Return encoder and link angle of the first joint at rest there [rad], in MuJoCo alone."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0] = shoulder
    data.ctrl[:] = shoulder, 0.0
    for _ in range(3000):
        mujoco.mj_step(model, data)
    upper = data.body("upper").xmat.reshape(3, 3)
    return data.joint("shoulder").qpos[0], np.arctan2(upper[0, 2], upper[2, 2])


def test_a_narrow_hinge_without_actuator_is_play(arm):
    simulation = Simulation.load(arm(PLAY))
    assert simulation.model.joint_names == ("shoulder", "elbow")
    (play,) = [effect for effect in simulation.effects if isinstance(effect, Backlash)]
    assert (play.joint, play.gap) == (1, pytest.approx(GAP))
    assert "joint slack has no actuator and 0.02 rad of range" in simulation.model.notes[0]


@pytest.mark.parametrize(
    "other",
    [
        PLAY.replace("0 1 0", "1 0 0"),  # about another axis
        PLAY.replace("/>", ' pos="0 0 .1"/>'),  # elsewhere
        PLAY.replace("-.01 .01", "-1 1"),  # of a range that no play has
        PLAY.replace("axis", 'type="slide" axis'),
    ],
)
def test_what_is_no_play_is_a_second_joint(arm, other):
    model = limo.RobotModel.load(f"{arm(other)}#shoulder,slack")
    assert model.joint_names[:2] == ("shoulder", "slack")
    assert model.description.plays == {}


def test_an_actuated_second_hinge_is_no_play(arm):
    moved = '<actuator><motor joint="slack"/></actuator>'
    assert limo.RobotModel.load(arm(PLAY, moved)).joint_names[:2] == ("shoulder", "slack")


def test_what_was_found_is_a_hinge_in_which_the_link_of_plain_mujoco_falls(arm, tmp_path):
    written = limo.export(with_play(arm()), "mjcf", tmp_path / "out")
    assert written.remainder == ()
    assert written.share < 0.01  # but for the moments in which it falls
    assert 'name="shoulder_backlash" type="hinge"' in written.diff
    for side in (-1.0, 1.0):
        encoder, link = settled(written.file, 0.5 * side)
        assert link - encoder == pytest.approx(side * GAP / 2, rel=0.02)  # falls outwards
        plain_encoder, plain_link = settled(arm(), 0.5 * side)
        assert plain_link == pytest.approx(plain_encoder, abs=1e-9)


def test_the_link_is_where_limo_says(arm, tmp_path):
    written = limo.export(with_play(arm()), "mjcf", tmp_path / "out")
    bare, still = Simulation(str(arm()), ()), np.zeros((2, 2))
    for side in (-1.0, 1.0):
        encoder, link = settled(written.file, 0.5 * side)
        encoders, links = (np.array([[angle, 0.0]] * 2) for angle in (0.5 * side, 0.0))
        links += encoders + [[link - encoder, 0.0]] * 2
        here, there = (limo.Motion(np.arange(2.0), q, still, still) for q in (encoders, links))
        without = bare.predict(here)[0]
        shift, expected = (
            with_play(arm()).predict(here)[0] - without,
            bare.predict(there)[0] - without,
        )
        assert abs(expected[0]) > 0.05  # N m
        np.testing.assert_allclose(shift, expected, rtol=0.03, atol=1e-3)


def test_a_damped_fall_is_the_damping_of_that_hinge_there_and_back(arm, tmp_path):
    path = arm(PLAY.replace("/>", ' damping="3"/>'))
    simulation = Simulation.load(path)
    (play,) = [effect for effect in simulation.effects if isinstance(effect, Backlash)]
    assert play.damping == 3.0
    others = [effect for effect in simulation.effects if effect is not play]
    again = replace(simulation, effects=(*others, replace(play, damping=5.0)))
    assert 'damping="5"' in limo.export(again, "mjcf", tmp_path / "again").diff
    bare = replace(simulation, robot=str(arm()), effects=(*others, play))
    written = limo.export(bare, "mjcf", tmp_path / "bare")
    assert play in Simulation.load(written.file).effects


@pytest.mark.slow("writes and reads four files")
def test_there_and_back_changes_nothing(arm, tmp_path):
    path = arm(PLAY)
    written = limo.export(Simulation.load(path), "mjcf", tmp_path / "out")
    assert written.file.read_bytes() == path.read_bytes()
    first = limo.export(with_play(arm()), "mjcf", tmp_path / "first")
    again = limo.export(Simulation.load(first.file), "mjcf", tmp_path / "again")
    assert again.diff == ""


@pytest.mark.slow("writes two files, and has MuJoCo prove each")
def test_another_gap_and_none_change_that_hinge(arm, tmp_path):
    simulation = Simulation.load(arm(PLAY))
    others = [effect for effect in simulation.effects if not isinstance(effect, Backlash)]
    for gap, ranges in ((0.03, 'range="-0.015 0.015"'), (0.0, "")):
        changed = replace(simulation, effects=(*others, Backlash(joint=1, gap=gap)))
        text = limo.export(changed, "mjcf", tmp_path / f"{gap}").file.read_text()
        assert ranges in text
        assert ("slack" in text.replace("limo wrote", "")) == bool(gap)


@pytest.mark.slow("writes two files, and has MuJoCo prove each")
def test_play_that_is_found_no_longer_goes(arm, tmp_path):
    path = arm()
    first = limo.export(with_play(path), "mjcf", tmp_path / "1").file
    second = limo.export(limo.nominal(path), "mjcf", tmp_path / "2", into=first)
    assert second.file.read_text() == path.read_text()
    assert second.dropped == (
        "joint shoulder: play 0.02 rad, which an earlier export wrote; the simulation has it no "
        "longer",
    )


@pytest.mark.parametrize(
    ("armature", "joint", "keys", "to"),
    [
        (0.0, 2, "", "mjcf"),  # a drive without inertia
        (0.05, 1, '<keyframe><key qpos="0 0"/></keyframe>', "mjcf"),
        (0.05, 1, "", "urdf"),
    ],
)
def test_where_it_is_not_expressible_its_size_is_said(arm, tmp_path, armature, joint, keys, to):
    simulation = with_play(arm(more=keys), armature=armature, joint=joint)
    written = limo.export(simulation, to, tmp_path / "out")
    place = f"backlash, joint {joint}"
    (said,) = [str(item) for item in written.remainder if item.place == place]
    assert "is not expressible" in said
    assert "N m RMS remain" in said
    assert "_backlash" not in written.file.read_text()
