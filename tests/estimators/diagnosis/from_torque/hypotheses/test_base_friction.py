"""Base friction: a simulation that gives joints no friction is not one of joints without any."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.candidates import BASE, candidates_of
from estimators.diagnosis.from_torque.hypotheses.search import (
    base_of,
    is_friction,
    level_of,
    with_friction,
    without_friction,
)
from estimators.diagnosis.from_torque.residuals.noise import ColumnTable
from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.physics import (
    CoulombFriction,
    JointCoupling,
    Payload,
    PreslidingHysteresis,
    QuadraticDrag,
    Simulation,
    Tolerances,
    TorqueGain,
    ViscousFriction,
)

WIDTHS = {1: 0.0005, 2: 0.004}  # [rad/s]


def observed_of(given, true, recording):
    """Return what a given simulation sees of a true arm on the motion of a recording."""
    random = np.random.default_rng(5)
    torque = true.predict(recording)
    noisy = replace(recording, torque=torque + 0.02 * random.standard_normal(torque.shape))
    return Observations.of(given, [noisy], 10.0)


@pytest.fixture(scope="module")
def bare(arm):
    return Simulation(str(arm))


@pytest.fixture(scope="module")
def true(arm):
    dry = [CoulombFriction(joint=j, tau_c=0.5 * j, v_eps=width) for j, width in WIDTHS.items()]
    return Simulation(str(arm), (*dry, ViscousFriction(joint=1, f_v=2.0)))


@pytest.mark.parametrize(
    ("effect", "joints"),
    [
        (QuadraticDrag(joint=2, coefficient=0.1), (0,)),
        (PreslidingHysteresis(joint=1, stiffness=(30.0,), width=(0.01,)), (1,)),
        (Payload(mass=1.0, com=(0.0, 0.0, 0.1), inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01)), (0, 1)),
        (JointCoupling(joint=1, other=2, f_v=1.0, tau_c=0.0, inertia=0.0, ratio=1), (0, 1)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_joint_with_friction_of_any_kind_is_not_bare(bare, effect, joints):
    assert without_friction(replace(bare, effects=(effect,))) == joints


def test_which_effects_are_laws_of_friction():
    assert [is_friction(effect) for effect in (*BASE, "payload", "link_inertia")] == [
        True,
        True,
        False,
        False,
    ]


def test_size_and_width_of_a_friction_that_is_not_in_are_found(bare, true, training_recording):
    observed = observed_of(bare, true, training_recording)
    found = {
        (effect.name, effect.joint): effect for effect in with_friction(observed).around.effects
    }
    for joint, width in WIDTHS.items():
        dry = found["coulomb_friction", joint]
        assert dry.tau_c == pytest.approx(0.5 * joint, rel=0.03)
        assert dry.v_eps == pytest.approx(width, rel=1.0)
    assert found["viscous_friction", 1].f_v == pytest.approx(2.0, rel=0.03)
    assert found["viscous_friction", 2].f_v < 0.05


def test_the_residual_stays_that_of_the_given_simulation(bare, true, training_recording):
    observed = observed_of(bare, true, training_recording)
    around = with_friction(observed)
    np.testing.assert_array_equal(around.residual, observed.residual)
    assert np.ptp(around.predicted[:, 0]) > np.ptp(observed.predicted[:, 0])


def test_the_search_starts_with_the_friction_of_bare_joints(bare, true, training_recording):
    given = replace(bare, effects=(CoulombFriction(joint=1, tau_c=0.5),))
    observed = with_friction(observed_of(given, true, training_recording))
    candidates = candidates_of(observed, ColumnTable(*observed.residual.shape), np.ones(2))
    base = [candidates[i].place for i in base_of(candidates, given)]
    assert base == [("coulomb_friction", (1,)), ("viscous_friction", (1,))]


def test_a_simulation_with_friction_at_all_joints_is_left_as_it_is(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording], 10.0)
    assert with_friction(observed) is observed


def test_what_may_be_missing_is_as_large_as_the_residual_and_three_times_the_noise_at_least():
    moving = np.array([[True, True], [True, True], [False, False]])
    seen = SimpleNamespace(residual=np.array([[3.0, 0.1], [-4.0, 0.1], [9.0, 9.0]]), moving=moving)
    assert level_of(seen, np.array([1.0, 0.2])) == pytest.approx([np.sqrt(12.5), 0.6])


def gains(observed):
    """Return the joints (0-based) at which a gain competes."""
    around = with_friction(observed)
    level = np.ones(observed.n)
    found = candidates_of(around, ColumnTable(len(observed.kept), observed.n), level)
    return {item.joints[0] for item in found if item.effect == TorqueGain.name}


@pytest.mark.slow("lays out four problems")
def test_no_gain_competes_where_most_torque_is_friction_that_nothing_is_stated_of(
    bare, training_recording
):
    light, most = (CoulombFriction(joint=2, tau_c=size, v_eps=0.004) for size in (0.02, 80.0))
    little, much = (replace(bare, effects=(effect,)) for effect in (light, most))
    assert gains(observed_of(bare, little, training_recording)) == {0, 1}
    assert gains(observed_of(bare, much, training_recording)) == {0}
    assert gains(observed_of(much, much, training_recording)) == {0, 1}  # it is stated
    tolerated = replace(bare, tolerances=Tolerances(gain=0.1))
    assert gains(observed_of(tolerated, little, training_recording)) == set()
