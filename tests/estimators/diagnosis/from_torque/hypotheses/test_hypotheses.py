"""Hypotheses: what each of them adds to a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.hypotheses.catalogue import every, recorded_in, rivals
from estimators.diagnosis.from_torque.residuals.observations import Observations
from limo_driver.physics import AsymmetricFriction, CoulombFriction, Simulation
from limo_driver.physics.catalogue import known_as
from limo_driver.physics.effect import Friction
from limo_driver.physics.effects.friction import sign_width_at
from limo_driver.recordings.recording import Recording

DRY = (
    CoulombFriction(joint=2, tau_c=1.0, v_eps=0.02),
    AsymmetricFriction(joint=2, tau_plus=1.0, tau_minus=0.8, v_eps=0.02),
)


@pytest.mark.parametrize("known", DRY, ids=lambda effect: effect.name)
def test_dry_friction_of_a_joint_has_the_sign_of_what_is_known_there(
    rigid, training_recording, known
):
    observed = Observations.of(replace(rigid, effects=(known,)), [training_recording], 10.0)
    warm = replace(observed.motion, temperature=np.full_like(observed.motion.position, 30.0))
    observed = replace(observed, motion=warm)
    widths = {
        (hypothesis.effect, term.v_eps)
        for hypothesis in every(observed)
        if hypothesis.joints == (1,) and issubclass(known_as(hypothesis.effect), Friction)
        for term in hypothesis.terms
        if hasattr(term, "v_eps")
    }
    own = {"load_dependent_friction": 0.002}  # keeps a sharp sign
    assert all(width == own.get(effect, 0.02) for effect, width in widths)
    assert {effect for effect, _ in widths} == {
        "coulomb_friction", "asymmetric_friction", "stribeck_friction", "load_dependent_friction",
        "position_dependent_friction", "temperature_dependent_friction",
    }  # fmt: skip
    assert sign_width_at(1, recorded_in(observed)) == 0.002


def test_a_ripple_is_offered_where_the_joint_turns_through_half_of_it(rigid):
    """Over 100 degrees 4 and 2 cycles are seen, over 80 none, over 200 all of a sensor's."""
    t = np.arange(0.0, 40.0, 0.01)
    for degrees, expected in (
        (80, set()),
        (100, {(4.0,), (2.0, 4.0)}),
        (200, {(4.0,), (2.0, 4.0), (1.0, 2.0, 4.0)}),
    ):
        swing = np.radians(degrees / 2) * np.sin(0.9 * t)
        position = np.column_stack([swing, 0.1 * np.sin(t)])
        recording = Recording.from_arrays(t, position, position)
        observed = Observations.of(rigid, [recording], 10.0)
        offered = [h for h in every(observed) if h.effect == "torque_ripple"]
        assert {h.settings for h in offered} == expected
        assert all(h.joints == (0,) for h in offered)


@pytest.mark.parametrize(("seconds", "offered"), [(60.0, True), (20.0, False)])
def test_warming_and_drift_are_offered_where_a_recording_lasts(
    rigid, training_recording, seconds, offered
):
    part = training_recording[: int(seconds * training_recording.rate)]
    names = {h.effect for h in every(Observations.of(rigid, [part], 10.0))}
    assert ("torque_drift" in names) is offered
    assert ("temperature_dependent_friction" in names) is offered


def test_coupling_is_offered_between_neighbours_and_every_other_joint():
    t = np.arange(0.0, 20.0, 0.01)
    position = 0.5 * np.sin(t[:, None] + np.arange(7))
    observed = Observations.of(
        Simulation("iiwa14"), [Recording.from_arrays(t, position, position)], 10.0
    )
    pairs = {h.joints for h in every(observed) if h.effect == "joint_coupling"}
    assert pairs == {(j, k) for j in range(7) for k in range(7) if 1 <= abs(j - k) <= 2}


def test_asymmetric_friction_alone_cannot_push(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording], 10.0)
    (skewed,) = AsymmetricFriction.at_joint(2, recorded_in(observed))
    (effect,) = skewed.realise(np.array([0.4, -0.3]))
    assert (effect.tau_plus, effect.tau_minus) == (0.4, 0.0)


def test_a_gear_without_compliance_is_as_stiff_as_any_may_be(rigid, training_recording):
    """A fit may leave none of it, which is an explanation too, not a value out of range."""
    observed = Observations.of(rigid, [training_recording], 10.0)
    soft = [h for h in every(observed) if h.effect == "joint_elasticity"]
    for hypothesis in (*soft, *(law for h in soft for law in rivals(h))):
        for nothing in (0.0, -0.3):
            (effect,) = hypothesis.realise(np.full(len(hypothesis.terms), nothing))
            assert effect.stiffness == 1e8
        (effect,) = hypothesis.realise(np.array([2.0, 0.0][: len(hypothesis.terms)]))
        assert effect.stiffness == pytest.approx(5e4)
