"""Export of arms whose joints follow others: the coupling stays, and so does their own friction."""

import mujoco
import pytest
from linked_arms import parallelogram

import limo_driver as limo
from limo_driver.physics import CoulombFriction, Simulation


@pytest.fixture
def model(tmp_path):
    (tmp_path / "linkage.xml").write_text(parallelogram(' frictionloss="0.7"'), encoding="utf-8")
    return tmp_path / "linkage.xml"


def test_a_simulation_as_the_file_has_it_changes_nothing(model, tmp_path):
    nominal = Simulation.load(model)
    dry = {effect.joint: effect.tau_c for effect in nominal.effects}
    assert dry == {2: pytest.approx(1.4)}  # of the shoulder and the joint that follows it
    exported = limo.export(nominal, "mjcf", tmp_path / "out")
    assert exported.diff == ""
    assert exported.share < 1e-3


@pytest.mark.slow("writes files, and has MuJoCo prove each")
def test_friction_that_was_found_is_that_of_both(model, tmp_path):
    found = Simulation(str(model), (CoulombFriction(joint=2, tau_c=2.0, v_eps=0.005),))
    exported = limo.export(found, "mjcf", tmp_path / "out")
    written = mujoco.MjModel.from_xml_path(str(exported.file))
    assert written.joint("shoulder").frictionloss == pytest.approx(1.3)
    assert written.joint("level").frictionloss == pytest.approx(0.7)
    assert written.neq == 1
    assert exported.share < 1e-3
    again = limo.export(found, "mjcf", tmp_path / "again", into=exported.file)
    assert again.diff == ""


def test_less_friction_than_what_follows_has_is_said(model, tmp_path):
    found = Simulation(str(model), (CoulombFriction(joint=2, tau_c=0.3, v_eps=0.005),))
    exported = limo.export(found, "mjcf", tmp_path / "out")
    assert "joint shoulder: the file's own friction of what follows it, 0.7 as" in exported.kept[-1]
    written = mujoco.MjModel.from_xml_path(str(exported.file))
    assert written.joint("shoulder").frictionloss == 0.0
