"""What a file states of its joints stays where a simulation says nothing of it."""

import pytest
from lanes import sampled

import limo_driver as limo
from limo_driver.exports.changes.origin import alike
from limo_driver.exports.changes.target import dropped_lines
from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics import (
    Armature,
    Backlash,
    CoulombFriction,
    PreslidingHysteresis,
    Simulation,
    StribeckFriction,
    TorqueRipple,
    ViscousFriction,
)

ARM = """<mujoco><worldbody>
<body name="l1"><joint name="yaw" axis="0 0 1" damping="0.3" armature="0.02" frictionloss="0.5"/>
<geom type="capsule" fromto="0 0 0 0 0 .2" size=".05" mass="3"/>
<body name="l2" pos="0 0 .2"><joint name="elbow" axis="0 1 0" armature="0.02"/>
<geom type="capsule" fromto="0 0 0 0 0 .3" size=".04" mass="2"/></body></body>
</worldbody></mujoco>
"""
YAW, ELBOW = 1, 2


@pytest.fixture
def arm(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(ARM, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        (0.0, 9e-13, True), (0.0, 1.1e-12, False), (2.0, 2.0 + 1.9e-8, True),
        (2.0, 2.0 + 2.1e-8, False), ((1.0, 0.0), (1.0, 1e-3), False), ((1.0,), (1.0, 1.0), False),
    ],
)  # fmt: skip
def test_numbers_of_files_are_the_same_but_for_their_rounding(first, second, same):
    assert alike(first, second) is same


def test_a_simulation_that_says_nothing_changes_nothing(arm, tmp_path):
    written = limo.export(Simulation(str(arm)), "mjcf", tmp_path / "out")
    assert written.file.read_bytes() == arm.read_bytes()
    assert written.kept == (
        "joint yaw: the file's own dry friction 0.5 N m, damping 0.3 N m s/rad and armature 0.02 "
        "kg m² stay; the simulation says nothing of them",
        "joint elbow: the file's own armature 0.02 kg m² stays; the simulation says nothing of it",
    )
    assert "what limo predicts with what the file keeps" in written.headline()
    assert written.share < 1e-3


def test_only_the_kinds_that_were_found_of_a_joint_change(arm, tmp_path):
    found = Simulation(str(arm), (Armature(joint=YAW, inertia=0.05),))
    written = limo.export(found, "mjcf", tmp_path / "out")
    text, comment = written.file.read_text(), '\n  <!-- limo wrote: {"yaw": {"armature": '
    assert text.replace(f"{comment}[0.05, 0.02]}}}} -->", "") == ARM.replace("0.02", "0.05", 1)
    assert written.share < 1e-3


@sampled(
    "friction",
    [
        CoulombFriction(joint=YAW, tau_c=0.7, v_eps=0.01),
        StribeckFriction(joint=YAW, tau_s=0.8, v_s=0.2, delta=1.0),
    ],
    "writes and simulates a file each",
)
def test_friction_that_was_found_replaces_all_of_the_files(arm, tmp_path, friction):
    written = limo.export(Simulation(str(arm), (friction,)), "mjcf", tmp_path / "out")
    stated = limo.RobotModel(written.file).description.dynamics
    assert stated["yaw"].damping == 0.0
    assert stated["yaw"].friction == getattr(friction, "tau_c", 0.0)
    assert stated["yaw"].armature == stated["elbow"].armature == 0.02


def test_none_is_meant_where_it_is_said(arm, tmp_path):
    none = (CoulombFriction(joint=YAW, tau_c=0.0, v_eps=0.01), Armature(joint=ELBOW, inertia=0.0))
    written = limo.export(Simulation(str(arm), none), "mjcf", tmp_path / "out")
    stated = limo.RobotModel(written.file).description.dynamics
    assert (stated["yaw"].friction, stated["yaw"].damping, stated["yaw"].armature) == (0, 0, 0.02)
    assert stated["elbow"].armature == 0.0


def rubbing(arm, *joints):
    """A simulation of a file with friction and an armature that were found at some joints."""
    found = [CoulombFriction(joint=j, tau_c=0.9, v_eps=0.01) for j in joints]
    found += [Armature(joint=j, inertia=0.07) for j in joints]
    return Simulation(str(arm), tuple(found))


@pytest.mark.slow("writes four files, and has MuJoCo prove each")
def test_what_an_earlier_export_wrote_goes_with_its_effect(arm, tmp_path):
    first = limo.export(rubbing(arm, YAW, ELBOW), "mjcf", tmp_path / "1").file
    assert first.read_text().count("<!-- limo wrote") == 1
    second = limo.export(rubbing(arm, YAW), "mjcf", tmp_path / "2", into=first)
    assert [line.split(",")[0] for line in second.dropped] == [
        "joint elbow: dry friction 0.9 N m",
        "joint elbow: armature 0.07 kg m²",
    ]
    assert second.share < 1e-3
    only_yaw = limo.export(rubbing(arm, YAW), "mjcf", tmp_path / "3").file
    assert second.file.read_text() == only_yaw.read_text()
    third = limo.export(Simulation(str(arm)), "mjcf", tmp_path / "4", into=second.file)
    assert third.file.read_text() == ARM  # byte for byte, as it was before the first


def test_what_is_told_to_go_is_of_a_kind_that_the_simulation_has_no_longer(arm):
    """Of each joint by itself, and nothing that stood in the user's own file."""
    users = (ViscousFriction(joint=YAW, f_v=0.3), Armature(joint=YAW, inertia=0.02))
    wrote = (
        *users,
        CoulombFriction(joint=ELBOW, tau_c=0.9),
        Armature(joint=ELBOW, inertia=0.07),
        Backlash(joint=YAW, gap=0.01),
    )
    found = Simulation(str(arm), (StribeckFriction(joint=ELBOW, tau_s=0.8, v_s=0.2),))
    gone = [line.split(",")[0] for line in dropped_lines(found, wrote, users)]
    assert gone == ["joint elbow: armature 0.07 kg m²", "joint yaw: play 0.01 rad"]
    assert [line.split(":")[0] for line in dropped_lines(Simulation(str(arm)), wrote, users)] == [
        "joint elbow", "joint elbow", "joint yaw",
    ]  # fmt: skip


def test_a_number_that_the_user_changed_since_stays(arm, tmp_path):
    first = limo.export(rubbing(arm, ELBOW), "mjcf", tmp_path / "1").file
    first.write_text(first.read_text().replace('frictionloss="0.9"', 'frictionloss="0.4"'))
    second = limo.export(Simulation(str(arm)), "mjcf", tmp_path / "2", into=first)
    stated = limo.RobotModel(second.file).description.dynamics
    assert (stated["elbow"].friction, stated["elbow"].armature) == (0.4, 0.02)
    assert any("joint elbow: the file's own dry friction 0.4" in line for line in second.kept)


@pytest.mark.slow("writes two files, and has MuJoCo prove each")
def test_motors_that_an_earlier_export_wrote_go_too(arm, tmp_path):
    effects = (
        PreslidingHysteresis(joint=YAW, law="lugre", sigma_0=900.0, tau_c=0.7),
        TorqueRipple(joint=ELBOW, cycles_per_rev=(7.0,), amplitude=(0.2,), phase=(0.3,)),
    )
    first = limo.export(Simulation(str(arm), effects), "mjcf", tmp_path / "1").file
    assert first.read_text().count("<dcmotor") == 2
    second = limo.export(Simulation(str(arm)), "mjcf", tmp_path / "2", into=first)
    assert "<dcmotor" not in second.file.read_text()
    assert limo.RobotModel(second.file).description.dynamics == (
        limo.RobotModel(arm).description.dynamics
    )
    assert "which an earlier export wrote" in second.dropped[0]


def test_a_urdf_has_its_own_numbers_back(tmp_path, two_links_urdf):
    first = limo.export(rubbing(two_links_urdf, 1), "urdf", tmp_path / "1").file
    second = limo.export(Simulation(str(two_links_urdf)), "urdf", tmp_path / "2", into=first)
    before, after = (limo.RobotModel(x).description.dynamics for x in (two_links_urdf, second.file))
    assert after.get("a", JointDynamics()) == before.get("a", JointDynamics())
    assert "limo wrote" not in second.file.read_text()


@sampled(
    "said",
    ["{}", '{"yaw": 3}', '{"yaw": {"friction": ["a", 1]}}', "{]}"],
    "writes a file each, and has MuJoCo prove it",
)
def test_a_comment_that_makes_no_sense_says_nothing(arm, tmp_path, said):
    arm.write_text(ARM.replace("</worldbody>", f"</worldbody>\n<!-- limo wrote: {said} -->"))
    written = limo.export(Simulation(str(arm)), "mjcf", tmp_path / "out")
    assert len(written.kept) == 2
    assert written.dropped == ()
