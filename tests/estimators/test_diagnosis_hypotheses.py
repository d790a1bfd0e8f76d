"""Hypotheses: what each of them adds to a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.friction_hypotheses import friction, sign_width
from estimators.diagnosis.observations import Observations
from limo_driver.physics import AsymmetricFriction, CoulombFriction

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
        for hypothesis in friction(observed, 1)
        for term in hypothesis.terms
        if hasattr(term, "v_eps")
    }
    own = {"load_dependent_friction": 0.002}  # keeps a sharp sign
    assert all(width == own.get(effect, 0.02) for effect, width in widths)
    assert {effect for effect, _ in widths} == {
        "coulomb_friction", "asymmetric_friction", "stribeck_friction", "load_dependent_friction",
        "position_dependent_friction", "temperature_dependent_friction",
    }  # fmt: skip
    assert sign_width(observed, 1) == 0.002


def test_asymmetric_friction_alone_cannot_push(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording], 10.0)
    (skewed,) = (h for h in friction(observed, 1) if h.effect == "asymmetric_friction")
    (effect,) = skewed.realise(np.array([0.4, -0.3]))
    assert (effect.tau_plus, effect.tau_minus) == (0.4, 0.0)
