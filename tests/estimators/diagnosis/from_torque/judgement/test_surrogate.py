"""Surrogate: predicts what is a function of the motion, and nothing of noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.diagnosis.from_torque.judgement.surrogate import predictable_part
from estimators.diagnosis.from_torque.residuals.observations import Observations


@pytest.fixture(scope="module")
def observed(rigid, training_recording):
    return Observations.of(rigid, [training_recording], 10.0)


def coloured(observed, seed, memory=5.0):
    """Noise that forgets within some rows, of unit size, (K,)."""
    random = np.random.default_rng(seed)
    a = np.exp(-1 / memory)
    drawn = np.sqrt(1 - a**2) * random.standard_normal(observed.kept.size + 200)
    return lfilter([1.0], [1.0, -a], drawn)[200:]


def explained(residual, guess, rows):
    return 1 - np.mean((residual - guess)[rows] ** 2) / np.mean(residual[rows] ** 2)


def test_predicts_a_function_of_another_joints_load(observed):
    load = observed.load[:, 1]
    sign = np.tanh(observed.motion.velocity[:, 0] / 0.002)
    planted = observed.filter((0.3 * sign * np.abs(load) / np.abs(load).max())[:, None])[:, 0]
    residual = planted + 0.03 * coloured(observed, 0)
    rows = observed.moving[:, 0]
    guess = predictable_part(observed, residual, 0)
    assert explained(planted, guess, rows) > 0.95


def test_predicts_hysteresis_of_a_width_that_is_no_feature(observed, true_arm, rigid):
    residual = observed.filter(observed.predict(true_arm) - observed.predict(rigid))[:, 0]
    rows = observed.moving[:, 0]
    assert explained(residual, predictable_part(observed, residual, 0), rows) > 0.8


@pytest.mark.parametrize("seed", range(6))
def test_predicts_nothing_of_coloured_noise(observed, seed):
    residual = coloured(observed, seed)
    rows = observed.moving[:, 1]
    assert 0 <= explained(residual, predictable_part(observed, residual, 1), rows) < 0.1


def test_no_row_is_predicted_from_itself(observed):
    """A pulse on rows of one fold is not predicted: nothing else in the recording is like it."""
    random = np.random.default_rng(2)
    residual = np.zeros(observed.kept.size)
    residual[400:403] = 1.0
    residual += 1e-3 * random.standard_normal(residual.size)
    guess = predictable_part(observed, residual, 0)
    assert np.abs(guess[400:403]).max() < 0.2


def test_rows_at_rest_are_not_looked_at(observed):
    residual = coloured(observed, 3)
    spoilt = np.where(observed.moving[:, 0], residual, 1e6)
    np.testing.assert_array_equal(
        predictable_part(observed, residual, 0), predictable_part(observed, spoilt, 0)
    )


def test_a_drift_is_predicted_in_its_own_recording_alone(rigid, training_recording, test_recording):
    both = Observations.of(rigid, [training_recording, test_recording], 10.0)
    own = both.recording == 1
    drift = np.where(own, np.sin(0.1 * both.slow.time), 0.0)
    rows = both.moving[:, 0]
    guess = predictable_part(both, drift + 0.03 * coloured(both, 0), 0)
    assert explained(drift, guess, rows & own) > 0.9
    assert np.sqrt(np.mean(guess[rows & ~own] ** 2)) < 0.1
