"""Smoothing at the bandwidth that positions need: calm at rest, sharp at starts, without phase."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.physics import CoulombFriction, Simulation
from limo_driver.recordings.filters.adaptive_smoothing import (
    differentiate_adaptively,
    encoder_noise,
)
from limo_driver.recordings.filters.differentiation import differentiate
from limo_driver.recordings.recording import Recording

RATE, BANDWIDTH, NOISE = 500.0, 40.0, 1e-5  # [Hz], [Hz], [rad]
TIME = np.arange(0, 8, 1 / RATE)
WHOLE = [slice(0, TIME.size)]
START, STOP = 3.0, 5.0  # [s] of motion


def steps(noise, seed=0):
    """Return position (T, 1) and velocity (T,) of a joint at rest that moves once, and noise."""
    share = np.clip((TIME - START) / (STOP - START), 0, 1)
    position = 0.5 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    velocity = 0.5 * (30 * share**2 - 60 * share**3 + 30 * share**4) / (STOP - START)
    return (position + noise * np.random.default_rng(seed).standard_normal(TIME.size))[
        :, None
    ], velocity


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def velocities():
    """Return the errors of the velocity by the adaptive and by the fixed filter, (T,) each."""
    position, velocity = steps(NOISE)
    adaptive = differentiate_adaptively(TIME, position, BANDWIDTH, WHOLE).first[:, 0] - velocity
    fixed = differentiate(TIME, position, BANDWIDTH, WHOLE).first[:, 0] - velocity
    return adaptive, fixed


def test_a_joint_at_rest_hardly_seems_to_move(velocities):
    adaptive, fixed = (
        error[(TIME > 0.5) & (TIME < START - 0.3)] for error in velocities
    )  # away from the start by the longest memory, and from the end of the recording
    assert rms(adaptive) < 0.05 * rms(fixed)


def test_a_start_and_a_stop_are_seen_no_worse_than_by_the_sharp_filter(velocities):
    adaptive, fixed = velocities
    for instant in (START, STOP):
        near = np.abs(TIME - instant) < 0.15
        assert rms(adaptive[near]) < rms(fixed[near])


def test_motion_is_seen_no_worse_than_by_the_sharp_filter(velocities):
    adaptive, fixed = velocities
    moving = (TIME > START + 0.2) & (TIME < STOP - 0.2)
    assert rms(adaptive[moving]) < rms(fixed[moving])


def test_a_joint_that_stands_still_has_no_velocity():
    position = np.concatenate([steps(NOISE)[0], np.full((TIME.size, 1), 0.3)], axis=1)
    found = differentiate_adaptively(TIME, position, BANDWIDTH, WHOLE)
    assert (found.value[:, 1] == 0.3).all()
    assert not found.first[:, 1].any()
    assert not found.second[:, 1].any()


def test_there_is_no_delay():
    angle = 2 * np.pi * 2.0 * TIME
    noise = 1e-4 * np.random.default_rng(1).standard_normal(TIME.size)
    position = (0.1 * np.sin(angle) + noise)[:, None]
    found = differentiate_adaptively(TIME, position, BANDWIDTH, WHOLE).first[250:-250, 0]
    parts = np.stack([np.cos(angle), np.sin(angle)], axis=1)[250:-250]
    in_phase, behind = np.linalg.lstsq(parts, found)[0]
    assert in_phase == pytest.approx(0.1 * 2 * np.pi * 2.0, rel=2e-3)
    assert abs(behind / in_phase) < 2e-3


def test_times_may_be_uneven_and_all_but_fall_together():
    random = np.random.default_rng(2)
    time = TIME + random.uniform(-0.35, 0.35, TIME.size) / RATE
    time[1001] = time[1000] + 1e-7
    angle = 2 * np.pi * 1.0 * time
    position = (0.1 * np.sin(angle) + NOISE * random.standard_normal(TIME.size))[:, None]
    found = differentiate_adaptively(time, position, BANDWIDTH, WHOLE).first[250:-250, 0]
    true = 0.1 * 2 * np.pi * np.cos(angle)[250:-250]
    assert rms(found - true) < 2e-3 * rms(true)


def test_nothing_passes_a_gap():
    position, _ = steps(NOISE)
    half = TIME.size // 2
    moved = np.concatenate([position[:half], position[half:] + 1.0])
    segments = [slice(0, half), slice(half, TIME.size)]
    apart = differentiate_adaptively(TIME, position, BANDWIDTH, segments)
    jumped = differentiate_adaptively(TIME, moved, BANDWIDTH, segments)
    np.testing.assert_allclose(jumped.first, apart.first, atol=1e-9)
    np.testing.assert_allclose(jumped.value[half:], apart.value[half:] + 1.0, atol=1e-9)


def test_the_noise_of_the_encoder_is_found_beside_motion_and_an_impact():
    position, _ = steps(NOISE)
    position[2500:2505] += 1e-3
    assert encoder_noise(TIME, position, BANDWIDTH) == pytest.approx([NOISE], rel=0.1)


def test_the_noise_of_a_coarse_encoder_is_that_of_its_steps_in_motion():
    position, _ = steps(0.0)
    coarse = np.round(position / 1e-4) * 1e-4  # stands still for three quarters of the time
    found = encoder_noise(TIME, coarse, BANDWIDTH)
    assert found == pytest.approx([1e-4 / np.sqrt(12)], rel=0.3)


def test_predicted_friction_does_not_chatter_at_rest():
    position, _ = steps(NOISE)
    simulation = Simulation("iiwa14", (CoulombFriction(joint=7, tau_c=1.0),))
    rest = TIME < START - 0.3
    still = np.tile(position[rest], 7)
    recording = Recording.from_arrays(TIME[rest], still, np.zeros(still.shape))
    frictionless = simulation.without_effects().predict(recording)
    friction = (simulation.predict(recording) - frictionless)[250:-250, 6]
    assert np.abs(friction).max() < 0.05  # of 1 N m; by the sharp filter alone it reaches 0.6
