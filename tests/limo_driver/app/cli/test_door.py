"""A stranger's door: a log and a description in, what is missing and a better description out."""

import numpy as np
import pytest
from logged import numbered, written

from limo_driver.app.library.exporting import format_for
from limo_driver.physics import Simulation


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
