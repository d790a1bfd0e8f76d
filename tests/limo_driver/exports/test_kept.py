"""What a file states of its joints stays where a simulation says nothing of it."""

import pytest

import limo_driver as limo
from limo_driver.physics import Armature, CoulombFriction, Simulation, StribeckFriction

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


def test_a_simulation_that_says_nothing_changes_nothing(arm, tmp_path):
    written = limo.export(limo.nominal(arm), "mjcf", tmp_path / "out")
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
    assert written.file.read_text() == ARM.replace("0.02", "0.05", 1)
    assert written.share < 1e-3


@pytest.mark.parametrize(
    "friction",
    [
        CoulombFriction(joint=YAW, tau_c=0.7, v_eps=0.01),
        StribeckFriction(joint=YAW, tau_s=0.8, v_s=0.2, delta=1.0),
    ],
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
