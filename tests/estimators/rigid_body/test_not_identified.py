"""Base parameters that a motion says nothing of: named, and never a number of noise."""

from __future__ import annotations

import json
from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from estimators.rigid_body import identify
from estimators.rigid_body.page import identification_page
from estimators.rigid_body.tables import as_values, base_estimates, base_table, known_of, notes_of
from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.types import Motion

NAMED = "not identified by this motion: "


def exact(simulation, position, duration=4.0):
    """Record positions (T, n) and the very torque that a simulation gives them."""
    time = np.linspace(0.0, duration, len(position))
    motion = Motion.from_positions(time, position)
    return Recording.from_arrays(time, motion.position, simulation.predict(motion))


@pytest.fixture(scope="module")
def alike():
    """What is identified of seven joints that move alike, recorded to the last digit."""
    simulation = Simulation("iiwa14", (CoulombFriction(joint=1, tau_c=0.5),))
    way = 0.2 * (1.0 - np.cos(np.linspace(0.0, 2.0 * np.pi, 1000)))
    return identify(simulation.model, [exact(simulation, way[:, None] * np.ones(7))])


def test_joints_that_move_alike_show_some_parameters_and_name_the_others(alike):
    estimates = base_estimates(alike)
    known = {item.name for item in estimates if item.is_identified}
    assert alike.fit.excited < alike.base.rank
    assert alike.fit.condition == np.inf
    assert {"tau_c_1", "f_v_1"} <= known
    assert 0 < len(known) < len(estimates)
    (note,) = (text for text in notes_of(alike) if text.startswith(NAMED))
    first = note.removeprefix(NAMED).split(", ")[0]
    assert first == next(item.name for item in estimates if not item.is_identified)


def test_what_is_identified_is_right_and_the_rest_stays_as_described(alike):
    for item in base_estimates(alike):
        assert np.isfinite([item.value, item.nominal]).all()
        assert item.deviation >= 0.0
        if item.name == "tau_c_1":
            assert item.value == pytest.approx(0.5, abs=1e-5)
            assert item.deviation < 1e-3
        elif not item.is_identified:
            assert item.value == pytest.approx(item.nominal, abs=1e-3)


def test_covariances_are_symmetric_and_positive(alike):
    covariance = alike.fit.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert (np.diag(covariance) > 0.0).all()
    assert all(item.deviation >= 0.0 for item in alike.estimates)


def test_tables_page_and_json_say_so(alike):
    said = StringIO()
    Console(file=said, width=200).print(base_table(alike))
    names = [item.name for item in base_estimates(alike) if not item.is_identified]
    assert said.getvalue().count("not identified") == len(names)
    values = as_values(alike)
    assert [item["name"] for item in values["base"] if item["deviation"] is None] == names
    assert any(text.startswith(NAMED) for text in values["warnings"])
    assert "NaN" not in json.dumps(values)
    assert NAMED + names[0] in identification_page(alike, "sim.yaml").html()
    assert f"of {len(values['base'])} base parameters are known" in known_of(alike)


def test_friction_of_a_joint_that_rests_is_not_identified(two_links_urdf):
    friction = tuple(CoulombFriction(joint=j, tau_c=0.3, v_eps=0.01) for j in (1, 2))
    simulation = Simulation(str(two_links_urdf), friction)
    time = np.linspace(0.0, 1.0, 1000)
    position = np.stack([np.sin(9.0 * time) + np.sin(31.0 * time), np.full(1000, 0.3)], axis=1)
    found = identify(simulation.model, [exact(simulation, position, 10.0)])
    deviations = {item.name: item.deviation for item in base_estimates(found)}
    assert deviations["tau_c_2"] == np.inf
    assert deviations["tau_c_1"] < 0.01


def test_a_motion_that_shows_all_names_nothing(two_links_urdf):
    simulation = Simulation(str(two_links_urdf))
    time = np.linspace(0.0, 1.0, 2000)
    rates = (np.array([3.0, 5.0]), np.array([11.0, 19.0]), np.array([31.0, 43.0]))
    position = sum(0.4 * np.sin(2.0 * w * time[:, None] + w) for w in rates)
    found = identify(simulation.model, [exact(simulation, position, 20.0)])
    assert notes_of(found) == found.warnings
    assert found.fit.shown.all()
    assert np.isfinite(found.fit.condition)
