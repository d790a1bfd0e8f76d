"""Nuisance: what may move within tolerances, said in its own units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.nuisance import nuisance_of
from estimators.diagnosis.from_torque.hypotheses.responses import Improvement
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics import (
    CoulombFriction,
    JointElasticity,
    PositionDependentFriction,
    TimeDelay,
    Tolerances,
    TorqueGain,
    TorqueOffset,
)


@pytest.fixture(scope="module")
def observed(rigid, training_recording):
    dry = CoulombFriction(joint=2, tau_c=2.2, v_eps=0.004)
    soft = JointElasticity(joint=1, stiffness=500.0)
    return Observations.of(replace(rigid, effects=(dry, soft)), [training_recording], 10.0)


@pytest.fixture(scope="module")
def nuisance(observed):
    return nuisance_of(observed, ColumnTable(*observed.residual.shape), np.full(observed.n, 0.1))


def named(nuisance, name):
    return next(item for item in nuisance.parameters if item.name == name)


def test_every_column_has_a_parameter_of_its_own_name(nuisance):
    names = [item.name for item in nuisance.parameters]
    assert len(names) == nuisance.prior.index.size
    assert len(set(names)) == len(names)


@pytest.mark.parametrize(
    ("name", "coefficient", "nominal", "value", "unit"),
    [
        ("mass of lower", 0.03, 0.0, 0.03, "relative"),
        ("tau_c of joint 2 (coulomb friction)", 0.5, 2.2, 3.3, "N m"),
        ("tau_c of joint 2 (coulomb friction)", -1.5, 2.2, 0.0, "N m"),  # at its bound
        ("v_eps of joint 2 (coulomb friction)", np.log(2.0), 0.004, 0.008, "rad/s"),
        ("stiffness of joint 1 (joint elasticity)", -1.5, 500.0, 200.0, "N m/rad"),  # in 1 / k
        ("stiffness of joint 1 (joint elasticity)", 1.5, 500.0, 5e4, "N m/rad"),  # in one step
        ("lag of sensor 1", 0.3, 0.0, 3e-4, "s"),
        ("offset of sensor 2", -0.02, 0.0, -0.02, "N m"),
    ],
)
def test_a_coefficient_is_said_as_a_value(nuisance, name, coefficient, nominal, value, unit):
    found = named(nuisance, name)
    assert found.nominal == nominal
    assert found.value(coefficient) == pytest.approx(value)
    assert found.unit == unit


def test_what_is_said_is_what_is_entered(observed, nuisance):
    coefficients = 0.2 * np.random.default_rng(0).standard_normal(nuisance.prior.index.size)
    improvement = Improvement(observed.simulation)
    nuisance.enter(improvement, coefficients)
    dry, soft = improvement.effects
    said = {
        item.name: item.value(c) for item, c in zip(nuisance.parameters, coefficients, strict=True)
    }
    assert said["tau_c of joint 2 (coulomb friction)"] == pytest.approx(dry.tau_c)
    assert said["v_eps of joint 2 (coulomb friction)"] == pytest.approx(dry.v_eps)
    assert said["stiffness of joint 1 (joint elasticity)"] == pytest.approx(soft.stiffness)


@pytest.mark.parametrize(
    ("stated", "at_hand"),
    [
        (CoulombFriction(joint=2, tau_c=2.0, v_eps=0.004), {"tau_c": 3.0, "v_eps": 0.008}),
        (JointElasticity(joint=1, stiffness=500.0), {"stiffness": 200.0}),
    ],
)
def test_where_a_value_moved_to_counts_from_the_stated_one(observed, stated, at_hand):
    """What the start gives from the stated value is at hand, and one step back is as stated."""
    moved = replace(observed.simulation, effects=(replace(stated, **at_hand),))
    given = replace(observed.simulation, effects=(stated,))
    columns = ColumnTable(*observed.residual.shape)
    found = nuisance_of(observed.under(moved), columns, np.full(observed.n, 0.1), given)
    back = Improvement(moved)
    found.enter(back, -found.start)
    for item, start in zip(found.parameters, found.start, strict=True):
        if item.known:
            name = item.known.name
            assert item.value(start) == pytest.approx(at_hand[name])
            assert getattr(back.effects[0], name) == pytest.approx(getattr(stated, name))


def test_what_is_certain_has_no_tolerance_and_the_rest_keeps_its_own(nuisance):
    """A width is but guessed, and stays free beside the size of the same effect."""
    dry = nuisance.of({("coulomb_friction", (1,))})
    assert [nuisance.parameters[k].known.name for k in np.flatnonzero(dry)] == ["tau_c"]
    held = nuisance.certain(dry)
    assert held.prior.deviation[dry] == 0.0
    np.testing.assert_array_equal(held.prior.deviation[~dry], nuisance.prior.deviation[~dry])


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (TimeDelay(joint=2, delay=0.01), ["lag of sensor 2"]),
        (TorqueOffset(joint=1, offset=0.2), ["offset of sensor 1"]),
        (
            PositionDependentFriction(joint=2, positions=(0.0, 1.0), excess=(0.1, 0.2), v_eps=0.01),
            ["tau_c of joint 2 (coulomb friction)"],
        ),
        (CoulombFriction(joint=2, tau_c=1.0), []),
    ],
)
def test_what_an_effect_beside_it_says_at_its_joint_is_a_part_of_that(nuisance, found, said):
    marks = nuisance.contained_in([found])
    assert [nuisance.parameters[k].name for k in np.flatnonzero(marks)] == said


def test_bodies_come_first(nuisance):
    bodies = [item.name.endswith((" of upper", " of lower")) for item in nuisance.parameters]
    assert all(bodies[: 2 * PER_LINK])
    assert not any(bodies[2 * PER_LINK :])


def gains_of(given, stated=None):
    """Return the nuisance of gains that are known to 10 %, and the table of its columns."""
    columns = ColumnTable(*given.residual.shape)
    found = nuisance_of(given, columns, np.full(given.n, 0.1), stated)
    at = [k for k, item in enumerate(found.parameters) if item.name.startswith("gain of torque")]
    return found, columns, at


def test_gains_have_a_tolerance_only_where_one_is_stated(observed):
    assert gains_of(observed)[2] == []
    tolerant = replace(observed.simulation, tolerances=Tolerances(gain=0.1))
    found, columns, at = gains_of(observed.under(tolerant))
    assert found.prior.deviation[at] == pytest.approx([0.1, 0.1])
    assert [found.parameters[k].value(0.02) for k in at] == pytest.approx([0.02, 0.02])
    one = columns.apply(found.prior.index[at[:1]], np.ones(1))
    np.testing.assert_allclose(one[:, 0], observed.simulated[:, 0], atol=1e-9)
    assert not one[:, 1].any()


def test_a_gain_that_a_fit_has_moved_is_counted_from_what_is_stated(observed):
    tolerant = replace(observed.simulation, tolerances=Tolerances(gain=0.1))
    gain = TorqueGain(joint=2, gain=0.07)
    moved = replace(tolerant, effects=(*tolerant.effects, gain))
    found, _, at = gains_of(observed.under(moved), tolerant)
    assert found.start[at] == pytest.approx([0.0, 0.07])
    improvement = Improvement(moved)
    found.enter(improvement, np.where(np.isin(np.arange(found.start.size), at), 0.01, 0.0))
    gains = {e.joint: e.gain for e in improvement.simulation().effects if e.name == gain.name}
    assert gains == pytest.approx({1: 0.01, 2: 0.08})
    known = [item.place for item in found.parameters if item.known is not None]
    assert (gain.name, (1,)) not in known
