"""Joints that stand still have no velocity, and those that move have that of the filter alone."""

from __future__ import annotations

import numpy as np
import pytest

from limo_driver.recordings.filters.causal_differentiation import CausalDifferentiator
from limo_driver.recordings.filters.standstill import RestingDifferentiator

RATE, BANDWIDTH, DELAY, NOISE = 500.0, 20.0, 0.03, 1e-5  # [Hz], [Hz], [s], [rad]
TIME = np.arange(0, 6, 1 / RATE)
START, STOP = 2.0, 3.0  # [s] of motion


def moved_once(noise, step=0.0, seed=0):
    """Return position (T, 2) of two joints that rest, turn once and rest, and velocity (T,)."""
    share = np.clip((TIME - START) / (STOP - START), 0, 1)
    position = 0.5 * (10 * share**3 - 15 * share**4 + 6 * share**5)
    velocity = 0.5 * (30 * share**2 - 60 * share**3 + 30 * share**4) / (STOP - START)
    random = np.random.default_rng(seed)
    seen = position[:, None] + noise * random.standard_normal((TIME.size, 2)) + 0.3
    return (np.round(seen / step) * step if step else seen), velocity


def both(position):
    """Return motion of a differentiator that rests, and of one that does not."""
    found = []
    for kind in (RestingDifferentiator, CausalDifferentiator):
        late = kind(RATE, BANDWIDTH, DELAY)
        found.append(late.advance(late.init(2), TIME, position)[0])
    return found


@pytest.mark.parametrize(("noise", "step"), [(NOISE, 0.0), (3e-6, 1e-5), (0.0, 1e-5), (0.0, 0.0)])
def test_a_joint_at_rest_does_not_move(noise, step):
    rested, _ = both(moved_once(noise, step)[0])
    at_rest = (TIME > 0.3) & (TIME < START) | (TIME > STOP + 0.4)
    assert np.mean(rested.velocity[at_rest] == 0.0) > 0.98
    assert np.mean(rested.acceleration[at_rest] == 0.0) > 0.98


@pytest.mark.parametrize(("noise", "step"), [(NOISE, 0.0), (3e-6, 1e-5), (0.0, 0.0)])
def test_a_joint_that_moves_is_let_go_before_its_friction_shows(noise, step):
    position, velocity = moved_once(noise, step)
    rested, free = both(position)
    moves = np.abs(np.interp(TIME - DELAY, TIME, velocity)) > 2e-3  # [rad/s], the sign's width
    np.testing.assert_array_equal(rested.velocity[moves], free.velocity[moves])
    np.testing.assert_array_equal(rested.acceleration[moves], free.acceleration[moves])
    np.testing.assert_array_equal(rested.position, free.position)


def test_creeping_is_no_rest():
    creep = 2e-4 * TIME[:, None] + NOISE * np.random.default_rng(1).standard_normal((TIME.size, 2))
    rested, free = both(creep)
    held = rested.velocity[500:] == 0.0
    assert np.mean(held) < 0.2
    assert rested.velocity[500:].mean() == pytest.approx(free.velocity[500:].mean(), rel=0.2)


def test_the_noise_of_the_encoder_is_found_whatever_moves_or_hits_the_arm():
    position, _ = moved_once(NOISE)
    position[1600:1605] += 1e-3
    late = RestingDifferentiator(RATE, BANDWIDTH, DELAY)
    _, memory = late.advance(late.init(2), TIME, position)
    found = late.to_noise * np.sqrt(memory.anchors[:, 3])
    # 30 positions around the hit count with at most 25 times the variance, of 2500 that are kept
    assert found == pytest.approx([NOISE, NOISE], rel=0.2)


def test_scanning_equals_the_batch_and_leaves_memory_as_it_was():
    position, _ = moved_once(NOISE)
    late = RestingDifferentiator(RATE, BANDWIDTH, DELAY)
    whole, last = late.advance(late.init(2), TIME, position)
    memory, found = late.init(2), []
    for time, own in zip(TIME, position, strict=True):
        before = memory.anchors.copy()
        sample, after = late.step(memory, time, own)
        np.testing.assert_array_equal(memory.anchors, before)
        found.append(sample.velocity)
        memory = after
    np.testing.assert_allclose(found, whole.velocity, rtol=0, atol=1e-12)
    np.testing.assert_allclose(memory.anchors, last.anchors, rtol=1e-9)
