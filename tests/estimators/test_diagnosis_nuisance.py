"""Nuisance: what may move within tolerances, said in its own units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.columns import Columns
from estimators.diagnosis.improvement import Improvement
from estimators.diagnosis.nuisance import nuisance_of
from estimators.diagnosis.observations import Observations
from estimators.rigid_body.regressor import PER_LINK
from limo_driver.physics import CoulombFriction


@pytest.fixture(scope="module")
def observed(rigid, training_recording):
    dry = CoulombFriction(joint=2, tau_c=2.2, v_eps=0.004)
    return Observations.of(replace(rigid, effects=(dry,)), [training_recording], 10.0)


@pytest.fixture(scope="module")
def nuisance(observed):
    return nuisance_of(observed, Columns(*observed.residual.shape), np.full(observed.n, 0.1))


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
    (dry,) = improvement.effects
    said = {
        item.name: item.value(c) for item, c in zip(nuisance.parameters, coefficients, strict=True)
    }
    assert said["tau_c of joint 2 (coulomb friction)"] == pytest.approx(dry.tau_c)
    assert said["v_eps of joint 2 (coulomb friction)"] == pytest.approx(dry.v_eps)


def test_bodies_come_first(nuisance):
    bodies = [item.name.endswith((" of upper", " of lower")) for item in nuisance.parameters]
    assert all(bodies[: 2 * PER_LINK])
    assert not any(bodies[2 * PER_LINK :])
