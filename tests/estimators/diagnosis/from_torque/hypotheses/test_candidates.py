"""Candidates: each is as large as can be expected, in units of its own columns."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses import candidates
from estimators.diagnosis.from_torque.hypotheses.candidates import candidates_of
from estimators.diagnosis.from_torque.hypotheses.responses import Response
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.settings import MATTERS
from estimators.diagnosis.settings.fitting import CANDIDATES
from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.recording import Recording

LEVEL = np.array([2.0, 0.5])  # [N m]


@pytest.fixture(scope="module")
def laid_out(rigid, training_recording):
    """The candidates beside a simulation with dry friction, and the RMS of their columns."""
    dry = (CoulombFriction(joint=1, tau_c=0.3), CoulombFriction(joint=2, tau_c=3.0))
    stated = replace(rigid, effects=dry)
    observed = Observations.of(stated, [training_recording], 10.0)
    columns = ColumnTable(*observed.residual.shape)
    found = candidates_of(observed, columns, LEVEL)
    sizes = np.zeros((2, columns.count))
    for joint in (0, 1):
        values, at = columns.of_joint(joint)
        sizes[joint, at] = np.sqrt(np.mean(values**2, axis=0))
    return found, sizes / LEVEL[:, None]


def test_what_is_stated_may_have_each_other_width_and_no_other_value_in_its_place(laid_out):
    found, _ = laid_out
    for joint in (0, 1):
        own = [item for item in found if item.place == ("coulomb_friction", (joint,))]
        assert [item.other_width for item in own] == [False] + [True] * len(CANDIDATES.sharper)
        assert {item.kind for item in own} == {"wrong_parameter"}


def test_a_stated_value_may_change_by_itself_or_by_what_makes_a_plausible_torque(laid_out):
    found, sizes = laid_out
    revised = [item for item in found if item.effect == "coulomb_friction"]
    for item in revised:
        plausible = 1.0 / sizes[:, item.prior.index].max(axis=0)
        wanted = np.maximum(1.0, plausible)
        assert item.prior.deviation == pytest.approx(wanted)
    assert any((item.prior.deviation > 1.0).any() for item in revised)


def test_what_is_missing_makes_a_plausible_torque_at_the_joint_where_it_is_strongest(laid_out):
    found, sizes = laid_out
    missing = [item for item in found if item.hypothesis is not None]
    assert {len(item.hypothesis.joints) for item in missing} >= {0, 1, 2}
    for item in missing:
        strength = sizes[:, item.prior.index].max(axis=0)
        if item.hypothesis.is_list:
            strength = np.maximum(strength, MATTERS * strength.max())
        some = strength > 1e-9
        assert item.prior.deviation[some] == pytest.approx(1.0 / strength[some])


def test_of_a_list_what_hardly_shows_is_as_what_seldom_does_and_what_never_does_is_nothing():
    found = [Response((0,), np.full((1, 4), size)) for size in (1.0, 0.01, 0.0)]
    places = SimpleNamespace(effect="slip", joints=(0,), positive=True, is_list=True, most=3.0)
    item = candidates._enter_columns(places, found, ColumnTable(4, 1), np.array([2.0]))
    assert item.prior.deviation == pytest.approx([2.0, 2.0 / MATTERS, 0.0])


def test_a_stated_value_may_change_by_what_is_plausible_at_the_joint_where_it_is_strongest():
    found = Response((0, 1), np.array([[0.1] * 4, [0.4] * 4]))
    coupling = SimpleNamespace(name="coupling", joints=(1, 2))
    item = candidates._revised(coupling, [found], None, ColumnTable(4, 2), np.ones(2))
    assert item.prior.deviation == pytest.approx([2.5])


def test_a_load_is_as_heavy_as_arms_carry_at_the_end_of_the_last_link():
    arm = Simulation("iiwa14")
    time = np.arange(400) / 100.0
    position = 0.3 * np.sin(np.outer(time, np.arange(1.0, 8.0)))
    observed = Observations.of(arm, [Recording.from_arrays(time, position, position)], 10.0)
    columns = ColumnTable(*observed.residual.shape)
    found = candidates_of(observed, columns, np.ones(7))
    bodies = [arm.model.inertials[name] for name in arm.model.link_names]
    centre = float(np.linalg.norm(bodies[-1].com))
    mass = CANDIDATES.payload * sum(body.mass for body in bodies)
    lever = CANDIDATES.payload * (arm.model.length + centre)
    assert lever > 2.0 * centre
    largest = np.repeat([mass, mass * lever, mass * lever**2], [1, 3, 6])
    loads = [item.prior.deviation for item in found if item.effect == "payload"]
    assert len(loads) == len(CANDIDATES.parts_of_body)
    for part, deviation in zip(CANDIDATES.parts_of_body, loads, strict=True):
        assert deviation == pytest.approx(part * largest)
