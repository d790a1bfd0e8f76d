"""Findings: what stays unknown is told with the figures and the place of every joint."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.judgement.findings import Signs, confidence_of, unknown_of
from estimators.diagnosis.from_torque.judgement.judgement import RemainingResidual
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.settings.judgement import CONFIDENCE

FLOOR = np.array([0.05, 0.01])
BEFORE, AFTER = np.array([0.4, 0.3]), np.array([0.2, 0.1])


@pytest.fixture(scope="module")
def observed(rigid, training_recording):
    return Observations.of(rigid, [training_recording], 10.0)


def unknown(observed, joints, stand_ins=()):
    candidates = [SimpleNamespace(effect=effect, joints=on) for effect, on in stand_ins]
    problem = SimpleNamespace(observed=observed, candidates=candidates)
    series = np.tanh(observed.slow.velocity / 0.04)
    remaining = RemainingResidual(FLOOR, np.array([0.123, 0.045]), series)
    (found,) = unknown_of(problem, range(len(candidates)), remaining, joints, BEFORE, AFTER)
    return found


def test_every_unknown_joint_has_its_own_figures_and_place(observed):
    found = unknown(observed, (0, 1))
    assert found.joints == (1, 2)
    assert found.evidence == (
        "No effect of the catalogue explains a part of the remaining residual that a black box "
        "predicts from the motion: 0.0450 N m RMS at joint 2 (noise floor 0.0100 N m) and "
        "0.123 N m RMS at joint 1 (noise floor 0.0500 N m)."
    )
    assert "joint 1" in found.where.region
    assert "joint 2" in found.where.region
    assert found.where.figure == "joint-2"
    assert len(found.where.time) == len(found.where.recording)


def test_one_unknown_joint_is_told_alone(observed):
    found = unknown(observed, (1,))
    assert "joint 1" not in found.evidence + found.where.region


def test_what_stands_in_is_named_once_with_all_its_joints(observed):
    one = unknown(observed, (1,), [("presliding_hysteresis", (1,))]).evidence
    assert "the improved simulation has presliding hysteresis at joint 2 in place of a part" in one
    several = [("coulomb_friction", (0,)), ("coulomb_friction", (1,)), ("gravity_direction", ())]
    many = unknown(observed, (1,), several).evidence
    assert "coulomb friction at joints 1, 2 and gravity direction in place of" in many


@pytest.mark.parametrize(("material", "duration"), [(0.7, 10.0), (3.0, 150.0), (3.0, 5.0)])
def test_confidence_is_the_probability_of_a_logistic_regression(material, duration):
    ever, by_material, by_duration = CONFIDENCE.weights
    odds = np.exp(ever) * material**by_material * duration**by_duration
    expected = min(CONFIDENCE.highest, odds / (1.0 + odds))
    said = confidence_of(Signs(5.0, material, duration))
    assert said == pytest.approx(expected)
    assert confidence_of(Signs(-4.0, material, duration)) == said
    assert confidence_of(Signs(5.0, 0.0, duration)) < 1e-6
    assert confidence_of(Signs(1e9, 1e9, 1e9)) == CONFIDENCE.highest
