"""Improvement: what was found is written so that the simulation stays one that can exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.catalogue import derivative
from estimators.diagnosis.from_torque.hypotheses.responses import Improvement, body_of, payload_of
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.rigid_body.regressor import parameters_of
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.physics import (
    AsymmetricFriction,
    CoulombFriction,
    DiagnosisContext,
    GravityDirection,
    JointElasticity,
    Payload,
    PreslidingHysteresis,
    Simulation,
    SpringLoad,
    TorqueGain,
    ViscousFriction,
)

DRY = CoulombFriction(joint=2, tau_c=1.5, v_eps=0.004)
SOFT = JointElasticity(joint=3, stiffness=8e3)
GIVEN = Simulation("iiwa14", (DRY, ViscousFriction(joint=2, f_v=4.0), SOFT))


@pytest.fixture
def improvement():
    return Improvement(GIVEN)


def effects(improvement):
    return improvement.simulation().effects


def test_nothing_found_is_the_given_simulation(improvement):
    assert improvement.simulation() == GIVEN


def test_friction_of_the_same_joint_adds_up(improvement):
    improvement.add(CoulombFriction(joint=2, tau_c=0.5, v_eps=0.01))
    assert effects(improvement)[0] == CoulombFriction(joint=2, tau_c=2.0, v_eps=0.004)
    assert len(effects(improvement)) == 3


def test_friction_of_another_joint_is_one_more_effect(improvement):
    more = CoulombFriction(joint=1, tau_c=0.5)
    improvement.add(more)
    assert effects(improvement) == (*GIVEN.effects, more)


def test_compliances_of_the_same_joint_add_up(improvement):
    improvement.add(JointElasticity(joint=3, stiffness=8e3))
    assert effects(improvement)[2].stiffness == pytest.approx(4e3)


def test_sums_stay_within_the_bounds_of_a_parameter(improvement):
    improvement.add(CoulombFriction(joint=2, tau_c=1.0))
    for _ in range(3):
        improvement.revise(0, "tau_c", -0.9)
    assert effects(improvement)[0].tau_c >= 0


def test_effects_that_do_not_add_up_stay_two(improvement):
    for effect in (
        SpringLoad(joint=2, stiffness=3.0, rest=0.1),
        SpringLoad(joint=2, stiffness=1.0, rest=0.5),
        Payload(mass=1.0, com=(0.0, 0.0, 0.1)),
        Payload(mass=0.5, com=(0.0, 0.0, 0.1)),
    ):
        improvement.add(effect)
    assert len(effects(improvement)) == 7


def test_there_is_one_direction_of_gravity(improvement):
    for gravity in ((0.1, 0.0, -9.8), (0.2, 0.0, -9.8)):
        improvement.add(GravityDirection(gravity=gravity))
    assert effects(improvement)[3:] == (GravityDirection(gravity=(0.2, 0.0, -9.8)),)


def test_a_parameter_is_revised_by_a_part_of_itself(improvement):
    improvement.revise(0, "tau_c", 0.2)
    improvement.revise(2, "stiffness", -0.5)
    assert effects(improvement)[0].tau_c == pytest.approx(1.8)
    assert effects(improvement)[2].stiffness == pytest.approx(4e3)


def test_a_revision_within_tolerance_and_one_beyond_it_add_up(improvement):
    """Both are parts of the given value, as in the fit that found them."""
    improvement.revise(0, "tau_c", 0.1)
    improvement.revise(0, "tau_c", 1.0)
    assert effects(improvement)[0].tau_c == pytest.approx(1.5 * 2.1)


@pytest.mark.parametrize("change", [-2.0, -1.0, -0.5, 1.0])
def test_a_payload_of_another_mass_is_a_body_of_the_same_shape(rigid, change):
    stated = Payload(mass=2.0, com=(0.0, 0.0, 0.1), inertia=(4e-3, 0.0, 0.0, 4e-3, 0.0, 2e-3))
    heavier = Improvement(replace(rigid, effects=(stated,)))
    heavier.revise(0, "mass", change)
    (found,) = heavier.effects
    part = max(0.0, 1.0 + change)  # no mass is below zero
    assert found.mass == 2.0 * part
    assert found.inertia == pytest.approx([part * item for item in stated.inertia])
    assert found.com == stated.com


def enter_skewed(improvement, joint):
    known = (CoulombFriction(joint=joint, tau_c=1.0, v_eps=0.01),)
    nothing = np.zeros((2, 7))
    gravity, inertia = np.array([0.0, 0.0, -9.81]), np.ones(nothing.shape[1])
    recorded = DiagnosisContext(nothing, None, 0.0, 1.0, 1.0, gravity, known, inertia)
    (skewed,) = AsymmetricFriction.at_joint(joint, recorded)
    improvement.enter(skewed, np.array([0.4, -0.3]))


def test_asymmetric_friction_takes_in_the_coulomb_friction_of_its_joint(improvement):
    enter_skewed(improvement, joint=2)
    expected = AsymmetricFriction(joint=2, tau_plus=1.9, tau_minus=1.2, v_eps=0.004)
    assert effects(improvement)[0] == expected
    enter_skewed(improvement, joint=5)
    last = effects(improvement)[-1]
    assert last == AsymmetricFriction(joint=5, tau_plus=0.4, tau_minus=0.0, v_eps=0.01)


def test_what_was_added_predicts_the_sum(improvement):
    model = RobotModel.load("iiwa14")
    improvement.add(TorqueGain(joint=4, gain=0.05))
    improvement.add(TorqueGain(joint=4, gain=0.02))
    assert effects(improvement)[-1].gain == pytest.approx(0.07)
    improvement.add(PreslidingHysteresis(joint=1, stiffness=(10.0,), width=(0.01,)))
    improvement.simulation().model.inverse_dynamics(*np.zeros((3, 1, model.n)))


@pytest.mark.parametrize("seed", range(20))
def test_every_body_that_comes_out_can_exist(seed):
    random = np.random.default_rng(seed)
    improvement = Improvement(GIVEN)
    model = GIVEN.model
    nominal = [parameters_of(model.inertials[name]) for name in model.link_names]
    for link, values in enumerate(nominal):
        improvement.move_inertia(link, random.normal(size=10) * (0.05 + 0.5 * np.abs(values)))
    for body in improvement.simulation().inertials.values():
        assert body.mass > 0
        assert body.is_consistent()


def test_mass_and_centre_of_mass_are_kept_where_the_inertia_gives_way(improvement):
    link, name = 3, GIVEN.model.link_names[3]
    nominal = GIVEN.model.inertials[name]
    change = np.zeros(10)
    change[0] = 0.1 * nominal.mass
    change[1:4] = 0.1 * nominal.mass * np.array(nominal.com)
    change[4] = -10.0  # no body has this
    improvement.move_inertia(link, change)
    body = improvement.simulation().inertials[name]
    assert body.is_consistent()
    assert body.mass == pytest.approx(1.1 * nominal.mass)
    np.testing.assert_allclose(body.com, nominal.com)


def test_a_possible_body_is_taken_as_it_is(improvement):
    name = GIVEN.model.link_names[5]
    nominal = GIVEN.model.inertials[name]
    change = 0.2 * parameters_of(nominal)
    improvement.move_inertia(5, change)
    body = improvement.simulation().inertials[name]
    np.testing.assert_allclose(parameters_of(body), 1.2 * parameters_of(nominal), atol=1e-12)
    assert body.mass == pytest.approx(1.2 * nominal.mass)


def test_parameters_of_a_body_come_back():
    body = GIVEN.model.inertials[GIVEN.model.link_names[1]]
    again = body_of(parameters_of(body))
    assert again is not None
    np.testing.assert_allclose(again.com, body.com)
    np.testing.assert_allclose(again.inertia, body.inertia, atol=1e-12)


def test_a_payload_keeps_mass_and_centre_and_is_a_body():
    payload = payload_of(np.array([2.0, 0.0, 0.02, 0.2, *(6 * (-0.1,))]))
    assert payload.mass == 2.0
    np.testing.assert_allclose(payload.com, (0.0, 0.01, 0.1))
    Simulation("iiwa14", (payload,)).body.inverse_dynamics(*np.zeros((3, 1, 7)))


def test_a_payload_without_mass_is_refused():
    with pytest.raises(ConfigError, match="a payload has to have mass"):
        payload_of(np.array([-0.1, *(9 * (0.0,))]))


def test_a_value_at_its_bound_has_a_derivative(rigid, training_recording):
    """A sign as wide as any may be: one step further, there is no such friction."""
    wide = CoulombFriction(joint=1, tau_c=1.0, v_eps=1.0)
    observed = Observations.of(replace(rigid, effects=(wide,)), [training_recording], 10.0)
    by_width = derivative(observed, wide, "v_eps").values
    by_size = derivative(observed, wide, "tau_c").values
    # slow motion is linear in the inverse of so wide a sign; taken from one side of it
    assert by_width == pytest.approx(-by_size, rel=0.06, abs=1e-3)
