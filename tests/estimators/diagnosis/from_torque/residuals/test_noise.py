"""Noise: a known autoregression is found, whitening whitens, and nothing leaks between runs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from estimators.diagnosis.from_torque.judgement.surrogate import swings
from estimators.diagnosis.from_torque.residuals.noise import Noise, roughness
from estimators.diagnosis.settings.residuals import NOISE

ROWS = 20_000
WHITE = np.array([0.03, 0.2])  # [N m]
WEIGHT = np.array([[0.9, -0.2, 0.0], [0.5, 0.2, 0.1]])  # of the last three rows


@pytest.fixture(scope="module")
def errors():
    """Errors of two joints, stationary autoregressions of known weights, (K, 2)."""
    random = np.random.default_rng(3)
    drawn = WHITE * random.standard_normal((ROWS + 500, 2))
    columns = [lfilter([1.0], np.r_[1.0, -w], x) for w, x in zip(WEIGHT, drawn.T, strict=True)]
    return np.stack(columns, axis=1)[500:]


ALL = np.ones((ROWS, 2), dtype=bool)
ONE = np.zeros(ROWS, dtype=np.int64)  # one segment


def test_a_known_autoregression_is_recovered(errors):
    noise = Noise.of(errors, ALL, ONE)
    np.testing.assert_allclose(noise.weight[:, NOISE.order], WEIGHT, atol=0.03)
    np.testing.assert_allclose(noise.white[:, NOISE.order], WHITE, rtol=0.02)
    np.testing.assert_allclose(noise.white[:, 0], errors.std(axis=0), rtol=0.02)


def test_whitened_rows_are_white_and_of_unit_size(errors):
    noise = Noise.of(errors, ALL, ONE)
    for joint in range(2):
        white = noise.whiten(errors[:, joint], joint)
        assert white.std() == pytest.approx(1.0, rel=0.02)
        for lag in (1, 2, 3, 5, 10):
            assert abs(np.mean(white[lag:] * white[:-lag])) < 5 / np.sqrt(ROWS)
        assert abs(np.mean(errors[1:, joint] * errors[:-1, joint])) > 0.5 * errors[:, joint].var()


def test_the_first_rows_of_each_run_are_of_unit_size_too(errors):
    """Rows with 0, 1 or 2 rows known before them have another deviation, which is known."""
    runs = np.repeat(np.arange(ROWS // 4), 4)
    noise = Noise.of(errors, ALL, runs)
    white = noise.whiten(errors[:, 0], 0).reshape(-1, 4)
    np.testing.assert_allclose(white.std(axis=0), 1.0, rtol=0.05)
    correlation = np.corrcoef(white.T)
    assert np.abs(correlation - np.eye(4)).max() < 0.06


def test_columns_are_whitened_as_errors_are(errors):
    noise = Noise.of(errors, ALL, ONE)
    columns = errors @ np.array([[1.0, 2.0, 0.5], [0.0, -1.0, 3.0]])
    whitened = noise.whiten(columns, 1)
    for k in range(3):
        np.testing.assert_allclose(whitened[:, k], noise.whiten(columns[:, k], 1), atol=1e-12)


def test_nothing_passes_a_gap_or_a_row_that_is_not_used(errors):
    use = ALL.copy()
    use[5000, 0] = False
    segment = (np.arange(ROWS) >= 12_000).astype(np.int64)
    noise = Noise.of(errors, use, segment)
    spoilt = errors.copy()
    spoilt[5000, 0] = 1e6
    spoilt[11_990:12_000] = 1e6
    again = Noise.of(spoilt, use & (spoilt < 1e5), segment)
    assert np.abs(again.weight - noise.weight).max() < 0.01
    before, after = (noise.whiten(values[:, 0], 0) for values in (errors, spoilt))
    changed = np.flatnonzero(before != after)
    np.testing.assert_array_equal(changed, [5000, *range(11_990, 12_000)])
    untouched = noise.whiten(errors[:, 1], 1)
    assert np.flatnonzero(untouched != noise.whiten(spoilt[:, 1], 1)).max() < 12_000


def test_independent_noise_only_scales(errors):
    noise = Noise.independent(WHITE, ALL)
    np.testing.assert_allclose(noise.whiten(errors[:, 1], 1), errors[:, 1] / WHITE[1])


def test_a_residual_of_nothing_has_a_noise():
    noise = Noise.of(np.zeros((300, 2)), np.ones((300, 2), dtype=bool), np.zeros(300, np.int64))
    assert np.all(noise.white > 0)
    assert np.all(np.isfinite(noise.whiten(np.ones(300), 0)))


def test_noise_that_never_forgets_is_predicted_with_care():
    """A ramp is not stationary; its autoregression must not explode."""
    ramp = np.linspace(-1, 1, 400)[:, None]
    noise = Noise.of(ramp, np.ones((400, 1), dtype=bool), np.zeros(400, np.int64))
    assert np.all(np.isfinite(noise.weight))
    assert np.all(noise.white > 0)


def test_roughness_sees_noise_and_no_slow_wave():
    random = np.random.default_rng(0)
    t = np.arange(4000) * 0.04
    white = 0.05 * random.standard_normal((4000, 1))
    wave = 3.0 * np.sin(2 * np.pi * 0.2 * t)[:, None]
    use = np.ones((4000, 1), dtype=bool)
    assert roughness(white + wave, use)[0] == pytest.approx(0.05, rel=0.05)


def test_roughness_looks_at_used_rows_only():
    random = np.random.default_rng(1)
    residual = 0.05 * random.standard_normal((4000, 1))
    residual[1000:1010] += 100.0
    use = np.ones((4000, 1), dtype=bool)
    use[1000:1010] = False
    assert roughness(residual, use)[0] == pytest.approx(0.05, rel=0.05)


def test_errors_that_swing_are_told_from_noise_and_from_slow_ones():
    random, rows = np.random.default_rng(8), 1600
    swing = lfilter([1.0], [1.0, -1.2, 0.97], random.standard_normal(rows))  # rings
    slow = np.cumsum(random.standard_normal(rows // 50 + 1)).repeat(50)[:rows]
    slow = np.convolve(slow, np.hanning(200) / 100, "same")
    noise = random.standard_normal((rows, 3))
    errors = noise + np.stack([0.7 * swing, 3.0 * slow, 0.0 * slow], axis=1)
    use, segment = np.ones((rows, 3), dtype=bool), np.arange(rows) // 400
    assert swings(errors, use, segment).tolist() == [True, False, False]
    few = use & (np.arange(rows) < 200)[:, None]
    assert not swings(errors, few, segment).any()  # too short to say
