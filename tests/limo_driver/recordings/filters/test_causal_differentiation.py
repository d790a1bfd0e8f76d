"""Causal differentiation: exact on polynomials, late by its delay alone, equal to its batch."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import ConfigError, RecordingError, ShapeError
from limo_driver.recordings.filters.causal_differentiation import CausalDifferentiator
from limo_driver.recordings.recording import Recording

BANDWIDTH = 10.0  # [Hz]


def scanned(differentiator, time, position):
    memory, samples = differentiator.init(position.shape[1]), []
    for t, q in zip(time, position, strict=True):
        sample, memory = differentiator.step(memory, t, q)
        samples.append(sample)
    return {
        name: np.array([getattr(sample, name) for sample in samples])
        for name in ("time", "position", "velocity", "acceleration")
    }


def wave(t):
    """Return position, velocity and acceleration of two joints of slow motion, (T, 2) each."""
    w, phase = 2 * np.pi * np.array([0.4, 0.9]), np.array([0.2, 1.0])
    angle = t[:, None] * w + phase
    return 0.3 * np.sin(angle), 0.3 * w * np.cos(angle), -0.3 * w**2 * np.sin(angle)


@settings(max_examples=30, deadline=None)  # the first call compiles
@given(
    rate=st.floats(60.0, 2000.0),
    delay=st.floats(0.06, 0.3),
    coefficients=st.lists(st.floats(-2.0, 2.0), min_size=6, max_size=6),
)
def test_a_quintic_is_differentiated_exactly_at_the_delayed_time(rate, delay, coefficients):
    late = CausalDifferentiator(rate, BANDWIDTH, delay)
    assert abs(late.delay - delay) <= 0.5001 / rate
    t = np.arange(2 * late.samples + 5) / rate
    quintic = np.polynomial.Polynomial(coefficients)
    motion, _ = late.advance(late.init(1), t, quintic(t)[:, None])
    settled = slice(2 * late.samples, None)
    np.testing.assert_allclose(motion.time, t - late.delay, atol=1e-12)
    for derivative, found in enumerate((motion.position, motion.velocity, motion.acceleration)):
        true = (quintic.deriv(derivative) if derivative else quintic)(motion.time[settled])
        np.testing.assert_allclose(found[settled, 0], true, atol=1e-12 * rate**derivative + 1e-9)


@pytest.mark.parametrize("rate", [100.0, 223.4, 1000.0])
def test_a_stream_sees_what_the_zero_phase_filter_sees_a_delay_earlier(rate):
    t = np.arange(0, 8, 1 / rate)
    position, velocity, acceleration = wave(t)
    recording = Recording.from_arrays(t, position, position)
    late, zero = CausalDifferentiator(rate, BANDWIDTH, 0.1), recording.motion(BANDWIDTH)
    motion, _ = late.advance(late.init(2), t, position)
    D = late.samples
    middle = slice(2 * D + int(rate), t.size - int(rate))
    before = slice(middle.start - D, middle.stop - D)
    for name, scale in (
        ("position", position),
        ("velocity", velocity),
        ("acceleration", acceleration),
    ):
        error = getattr(motion, name)[middle] - getattr(zero, name)[before]
        assert np.abs(error).max() < 1e-5 * np.abs(scale).max()


def test_noise_grows_as_the_delay_shrinks():
    rate, random = 1000.0, np.random.default_rng(0)
    noise = 1e-5 * random.standard_normal((4000, 1))
    heard = []
    for delay in (0.02, 0.05, 0.1):
        late = CausalDifferentiator(rate, BANDWIDTH, delay)
        motion, _ = late.advance(late.init(1), np.arange(4000) / rate, noise)
        heard.append(motion.acceleration[300:].std())
    assert heard[0] > 3 * heard[1] > 3 * heard[2]


@pytest.mark.parametrize("samples", [1, 7, 400])
def test_scanning_equals_the_batch(samples):
    t = np.cumsum(np.random.default_rng(1).uniform(0.8e-3, 1.2e-3, samples))
    t[samples // 2 :] += 7e-3  # lost samples
    position = wave(t)[0]
    late = CausalDifferentiator(1000.0, BANDWIDTH, 0.05)
    motion, _ = late.advance(late.init(2), t, position)
    for name, found in scanned(late, t, position).items():
        np.testing.assert_allclose(found, getattr(motion, name), rtol=0, atol=1e-12)


def test_the_arm_is_taken_to_have_rested_at_the_first_position():
    late = CausalDifferentiator(500.0, BANDWIDTH, 0.04)
    sample, _ = late.step(late.init(2), 3.0, np.array([0.4, -1.0]))
    assert sample.time == pytest.approx(3.0 - late.delay)
    np.testing.assert_allclose(sample.position, [0.4, -1.0], atol=1e-12)
    np.testing.assert_allclose(sample.velocity, 0.0, atol=1e-9)
    np.testing.assert_allclose(sample.acceleration, 0.0, atol=1e-7)


def test_lost_samples_are_bridged_and_gaps_are_told():
    late = CausalDifferentiator(1000.0, BANDWIDTH, 0.05)
    t = np.arange(0, 1, 1e-3)
    keep = np.ones(t.size, dtype=bool)
    keep[600:612] = False
    slope = 0.3 * t[:, None]
    motion, memory = late.advance(late.init(1), t[keep], slope[keep])
    np.testing.assert_allclose(motion.velocity[200:], 0.3, atol=1e-9)
    assert not late.gap(memory, t[-1] + 0.19)
    assert late.gap(memory, t[-1] + 0.21)
    assert not late.gap(late.init(1), 5.0)


def test_memory_is_never_changed_in_place():
    late = CausalDifferentiator(200.0, BANDWIDTH, 0.05)
    t = np.arange(60) / 200.0
    _, memory = late.advance(late.init(2), t, wave(t)[0])
    before = memory.positions.copy()
    first, _ = late.step(memory, 1.0, np.array([0.1, 0.2]))
    again, _ = late.step(memory, 1.0, np.array([0.1, 0.2]))
    np.testing.assert_array_equal(memory.positions, before)
    np.testing.assert_array_equal(first.acceleration, again.acceleration)


@pytest.mark.parametrize(
    ("rate", "bandwidth", "delay", "message"),
    [
        (1000.0, 10.0, 0.002, r"2 samples at 1000 Hz; at least 0.003 s, 3 samples"),
        (20.0, 10.0, 0.5, r"10 Hz is too high for positions at 20 Hz; at most 8 Hz"),
        (1000.0, 10.0, -0.1, r"delay = -0.1 s has to be above 0 and finite"),
        (np.nan, 10.0, 0.1, r"rate = nan Hz has to be above 0"),
        (1000.0, 0.0, 0.1, r"bandwidth = 0 Hz has to be above 0"),
        (1000.0, 10.0, np.inf, r"delay = inf s"),
        (100.0, 10.0, 1e6, r"a delay of 1e\+06 s is too long at 100 Hz; at most 5 s"),
        (1e6, 10.0, 0.1, r"a delay of 0.1 s is too long at 1e\+06 Hz; at most 0.025 s"),
    ],
)
def test_what_cannot_be_is_refused(rate, bandwidth, delay, message):
    with pytest.raises(ConfigError, match=message):
        CausalDifferentiator(rate, bandwidth, delay)


def test_bad_samples_are_refused():
    late = CausalDifferentiator(100.0, BANDWIDTH, 0.05)
    _, memory = late.step(late.init(2), 1.0, np.zeros(2))
    for time in (1.0, 0.5, np.nan, np.inf):
        with pytest.raises(RecordingError, match="its time has to increase"):
            late.step(memory, time, np.zeros(2))
    for memory_before in (memory, late.init(2)):
        with pytest.raises(RecordingError, match="time and values have to be finite"):
            late.step(memory_before, 1.01, np.array([0.0, np.nan]))
        with pytest.raises(RecordingError, match=r"no value beyond 1e\+09"):
            late.step(memory_before, 1.01, np.array([0.0, 1e200]))
    with pytest.raises(ShapeError, match=r"position has shape \(1, 3\), expected \(1, 2\)"):
        late.step(memory, 1.01, np.zeros(3))
