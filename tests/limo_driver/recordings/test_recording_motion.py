"""Differentiation without phase: analytic signals, uneven sampling, gaps, ends."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limo_driver.errors import RecordingError
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.filters.filtered_samples import LIVELIER
from limo_driver.recordings.recording import Recording

BANDWIDTH = 8.0  # [Hz]


def sinusoids(t, frequency, phase=0.3):
    """Return position, velocity and acceleration of two joints, (T, 2)."""
    w = 2 * np.pi * frequency
    angle = w * t[:, None] + np.array([phase, phase + 1.2])
    return np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)


def record(t, frequency, phase=0.3):
    position, _, _ = sinusoids(t, frequency, phase)
    return Recording.from_arrays(t, position, 3 * position)


def worst(found, true, rows):
    return float(np.abs(found - true)[rows].max() / np.abs(true).max())


@settings(max_examples=25, deadline=None)
@given(
    rate=st.floats(60.0, 1200.0),
    frequency=st.floats(0.05, BANDWIDTH / 4),
    phase=st.floats(0.0, 6.28),
    jitter=st.floats(0.0, 0.35),
    seed=st.integers(0, 1000),
)
def test_derivatives_of_a_sinusoid(rate, frequency, phase, jitter, seed):
    t = np.arange(int(6 * rate)) / rate
    t = t + jitter / rate * np.random.default_rng(seed).uniform(-1, 1, t.size)
    recording = record(t, frequency, phase)
    motion = recording.motion(BANDWIDTH)
    inside = ~recording.edges(BANDWIDTH)
    true = sinusoids(recording.time, frequency, phase)
    # the filter's own loss at f is (f / bandwidth)^8, 1.5e-5 at a quarter; derivatives double it
    for found, expected, bar in zip(
        (motion.position, motion.velocity, motion.acceleration),
        true,
        (1e-3, 2e-3, 1e-2),
        strict=True,
    ):
        assert worst(found, expected, inside) < bar


def test_in_the_middle_nothing_but_the_filter_is_lost():
    t = np.arange(0, 20, 0.004)
    recording = record(t, 1.0)
    motion = recording.motion(BANDWIDTH)
    middle = slice(500, -500)
    for found, expected in zip(
        (motion.position, motion.velocity, motion.acceleration), sinusoids(t, 1.0), strict=True
    ):
        assert worst(found, expected, middle) < 1e-6


def test_amplitude_is_halved_at_the_bandwidth():
    t = np.arange(0, 20, 0.002)
    motion = record(t, BANDWIDTH).motion(BANDWIDTH)
    assert np.ptp(motion.position[2000:-2000]) / 2 == pytest.approx(0.5, rel=1e-3)


def test_torque_goes_through_the_same_filter():
    t = np.sort(np.random.default_rng(0).uniform(0, 20, 4000))
    recording = record(t, 5.0)
    np.testing.assert_allclose(
        recording.filtered_torque(BANDWIDTH), 3 * recording.motion(BANDWIDTH).position, atol=1e-9
    )


def test_no_delay():
    t = np.arange(0, 10, 0.01)
    moved = record(t, 5.0).motion(BANDWIDTH).position[300:-300, 0]
    angle = 2 * np.pi * 5.0 * t[300:-300] + 0.3
    in_phase, behind = np.linalg.lstsq(np.stack([np.sin(angle), np.cos(angle)], 1), moved)[0]
    assert abs(np.arctan2(behind, in_phase)) < 1e-6


def test_ends_keep_the_acceleration():
    t = np.arange(0, 6, 0.005)
    motion = record(t, 0.5, phase=1.0).motion(BANDWIDTH)
    true = sinusoids(t, 0.5, phase=1.0)[2]
    assert worst(motion.acceleration, true, slice(None)) < 5e-3


def test_nothing_passes_a_gap():
    t = np.arange(0, 10, 0.005)
    keep = (t < 4) | (t > 5)
    position, velocity, acceleration = sinusoids(t, 0.8)
    position = position + 2.0 * (t > 4.5)[:, None]  # moved by hand while nothing was recorded
    recording = Recording.from_arrays(t[keep], position[keep], position[keep])
    assert len(recording.segments) == 2
    motion = recording.motion(BANDWIDTH)
    inside = ~recording.edges(BANDWIDTH)
    assert worst(motion.velocity, velocity[keep], inside) < 1e-3
    assert worst(motion.acceleration, acceleration[keep], inside) < 5e-3


def test_lost_samples_below_the_gap_are_bridged():
    t = np.arange(0, 10, 0.002)
    keep = np.random.default_rng(1).uniform(size=t.size) > 0.3
    recording = record(t[keep], 1.0)
    assert len(recording.segments) == 1
    motion = recording.motion(BANDWIDTH)
    inside = ~recording.edges(BANDWIDTH)
    assert worst(motion.acceleration, sinusoids(t[keep], 1.0)[2], inside) < 2e-3


def test_close_samples_do_not_blow_up_noise():
    random = np.random.default_rng(2)
    t = np.arange(0, 10, 0.01)
    t[1::50] = t[0::50] + 1e-6
    position = sinusoids(t, 0.5)[0]
    noisy = position + 1e-3 * random.standard_normal(position.shape)
    motion = Recording.from_arrays(t, noisy, noisy).motion(BANDWIDTH)
    assert np.abs(motion.position - position).max() < 5e-3


def test_slow_recordings_are_differentiated_too():
    t = np.arange(0, 20, 1 / 30)
    recording = record(t, 0.5)
    motion = recording.motion(10.0)
    inside = ~recording.edges(10.0)
    assert worst(motion.acceleration, sinusoids(t, 0.5)[2], inside) < 1e-3


def test_a_sharp_velocity_keeps_four_times_the_bandwidth_and_the_acceleration_hardly_more():
    t = np.arange(0, 20, 0.004)
    recording = record(t, 3.0 * BANDWIDTH)
    sharp, smooth = recording.sharp_motion(BANDWIDTH), recording.motion(BANDWIDTH)
    position, velocity, _ = sinusoids(t, 3.0 * BANDWIDTH)
    middle = slice(500, -500)
    assert worst(sharp.position, position, middle) < 0.1  # the filter's loss at 3/4, 0.091
    assert worst(sharp.velocity, velocity, middle) < 0.1
    assert np.abs(smooth.velocity[middle]).max() < 1e-3 * np.abs(velocity).max()
    lively = recording.motion(LIVELIER * BANDWIDTH)
    np.testing.assert_array_equal(sharp.acceleration, lively.acceleration)


def test_a_lively_acceleration_filtered_like_a_torque_keeps_what_the_torque_keeps():
    t = np.arange(0, 20, 0.004)
    recording = record(t, 0.9 * BANDWIDTH)
    middle, once = slice(500, -500), recording.motion(BANDWIDTH).acceleration

    def kept(acceleration):
        filtered = smooth(t, acceleration, BANDWIDTH, recording.segments)[middle]
        return np.abs(filtered).max() / np.abs(once[middle]).max()

    assert kept(recording.sharp_motion(BANDWIDTH).acceleration) > 0.92
    assert kept(recording.motion(BANDWIDTH).acceleration) < 0.75  # filtered twice


def test_a_sharp_velocity_is_no_sharper_than_the_rate_allows():
    recording = record(np.arange(400) / 40.0, 0.5)  # nothing above 16 Hz can be kept
    for bandwidth, kept in ((6.0, 14.4), (10.0, 14.4), (16.0, 16.0)):  # with a tenth of room
        sharp = recording.sharp_motion(bandwidth)
        np.testing.assert_allclose(sharp.velocity, recording.motion(kept).velocity, atol=1e-9)


def test_a_sharp_velocity_keeps_the_temperature():
    t = np.arange(0, 10, 0.01)
    position = sinusoids(t, 0.5)[0]
    warm = np.stack([30 + t, 31 + t], axis=1)
    recording = Recording.from_arrays(t, position, position, extras={"temperature": warm})
    np.testing.assert_array_equal(recording.sharp_motion(BANDWIDTH).temperature, warm)


def test_the_slowest_rate_is_that_of_the_slowest_stretch():
    t = np.concatenate([np.arange(0, 4, 0.005), np.arange(6, 12, 0.02)])
    recording = record(t, 0.5)
    assert len(recording.segments) == 2
    assert recording.rate == pytest.approx(200.0)
    assert recording.slowest_rate == pytest.approx(50.0)


@pytest.mark.parametrize("bandwidth", [0.0, -1.0, 50.0])
def test_a_bandwidth_that_cannot_be_is_refused(bandwidth):
    recording = record(np.arange(0, 4, 0.01), 0.5)
    with pytest.raises(RecordingError, match=r"sampled at 100 Hz; give more than 0 and at most 40"):
        recording.motion(bandwidth)


def test_what_is_scored_is_all_but_the_edges_and_has_to_be_something():
    recording = record(np.arange(0.0, 2.0, 0.01), 0.5)
    np.testing.assert_array_equal(recording.scored(10.0), ~recording.edges(10.0))
    with pytest.raises(RecordingError, match="too short to score: the filter of 10 Hz needs"):
        recording[:8].scored(10.0)
