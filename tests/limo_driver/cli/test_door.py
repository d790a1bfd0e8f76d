"""A stranger's door: a log and a description in, what is missing and a better description out."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from logged import numbered, written
from mjcf_arms import arm_of

from limo_driver.physics import CoulombFriction, Payload, Simulation, ViscousFriction
from limo_driver.types import Motion
from limo_driver.workflow.exporting import format_for


def test_neither_or_both_of_simulation_and_robot_are_refused(run):
    assert run("diagnose", "log.csv", "--out", "d")[0] == 2
    status, _, said = run("diagnose", "log.csv", "--out", "d", "--sim", "s", "--robot", "r")
    assert status == 2
    assert "both of --sim and --robot given" in said


@pytest.mark.parametrize(
    ("out", "own", "wanted"),
    [
        ("better.xml", "URDF", "mjcf"),
        ("better.urdf", "MJCF", "urdf"),
        ("folder", "URDF", "urdf"),
        ("better.usda", "USD", "usd"),
    ],
)
def test_the_ending_of_an_export_says_its_format(out, own, wanted):
    assert format_for(out, own) == wanted


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("better.sdf", "better.sdf: cannot be written: its ending is .sdf, expected .xml, .urdf"),
        ("better.usda", "an export to USD is a layer over a USD file; the robot is URDF"),
    ],
)
def test_an_export_that_cannot_be_is_refused_before_the_diagnosis(run, tmp_path, out, said):
    time = 0.004 * np.arange(500)
    log = {"t": time, **numbered("q{}_rad", np.sin(time[:, None] + np.arange(7)))}
    written(log | numbered("tau{}_nm", np.ones((500, 7))), tmp_path / "log.csv")
    status, _, notes = run(
        *("diagnose", "log.csv", "--robot", "iiwa14", "--out", "d", "--export", out),
    )
    assert (status, said in notes) == (2, True), notes


def test_an_ending_of_another_format_is_refused(run, tmp_path):
    Simulation("iiwa14").save(tmp_path / "sim.yaml")
    status, _, notes = run("export", "sim.yaml", "--to", "mjcf", "--out", "arm.urdf")
    assert (status, "arm.urdf: ends in .urdf, but an export to mjcf is MJCF" in notes) == (2, True)


@pytest.mark.slow("identifies, diagnoses and exports: ten seconds")
def test_from_a_csv_and_an_mjcf_to_the_payload_in_the_mjcf(run, tmp_path):
    """An arm that carries 0.7 kg of which its model knows nothing; degrees and milliseconds."""
    model = tmp_path / "model.xml"
    text = arm_of(3, dynamics=False).replace('range="-3 3"', 'range="-3 3" armature="0.08"')
    model.write_text(text, encoding="utf-8")
    time = np.arange(0, 40, 0.005)
    rate = 2 * np.pi * np.array([0.11, 0.17, 0.23, 0.31])
    phase = np.outer(time, rate) + np.arange(4)
    q, v, a = np.sin(phase), rate * np.cos(phase), -(rate**2) * np.sin(phase)
    nominal = Simulation.load(model)
    joints = range(1, 5)
    true = replace(
        nominal,
        effects=(
            *nominal.effects,  # the armatures of the file, which are right
            Payload(mass=0.7, com=(0.05, 0.02, 0.1), inertia=(0.002, 0, 0, 0.002, 0, 0.001)),
            *(CoulombFriction(joint=j, tau_c=0.8, v_eps=0.004) for j in joints),
            *(ViscousFriction(joint=j, f_v=0.6) for j in joints),
        ),
    )
    torque = true.predict(Motion(time, q, v, a))
    torque += np.random.default_rng(0).normal(0, 0.02, torque.shape)
    log = {"t_ms": 1e3 * time, **numbered("angle_{}_deg", np.rad2deg(q))}
    written(log | numbered("torque_{}", torque) | {"gripper": time}, tmp_path / "log.csv")
    status, said, notes = run(
        *("diagnose", "log.csv", "--robot", "model.xml", "--out", "found"),
        *("--export", "better/improved.xml"),
    )
    assert status == 0, notes
    assert "log.csv: read as time t_ms [ms], position angle_0_deg" in notes
    assert "log.csv: sampled at 200 Hz for" in notes
    verdict = json.loads((tmp_path / "found" / "verdict.json").read_text())
    names = [finding["effect"] for finding in verdict["findings"]]
    assert set(names) & {"payload", "link_inertia"}
    assert "MuJoCo alone needs what limo predicts, to 0." in said
    improved = mujoco.MjModel.from_xml_path(str(tmp_path / "better" / "improved.xml"))
    before = mujoco.MjModel.from_xml_path(str(model))
    added = improved.body_subtreemass[0] - before.body_subtreemass[0]
    assert added == pytest.approx(0.7, abs=0.25)
    np.testing.assert_allclose(improved.dof_frictionloss, 0.8, atol=0.2)
    np.testing.assert_allclose(improved.dof_damping, 0.6, atol=0.3)
    np.testing.assert_allclose(improved.dof_armature, 0.08, atol=0.03)
    assert "kept:" not in said  # beside what was found, the file has nothing of its own
    assert model.read_text() == text
