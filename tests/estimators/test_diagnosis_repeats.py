"""Repeats: recordings of one motion are recognised, and what comes again in them is no noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.judgement import leftover
from estimators.diagnosis.observations import Observations
from estimators.diagnosis.repeats import foretold_by_repeats, groups, notes
from limo_driver.recording import Recording

NOISE = 0.02  # [N m], of the shared recordings; white, of which the filter keeps a part


def later(recording: Recording, start: float, seed: int, hidden=0.0) -> Recording:
    """Record the motion again: later on another clock, with other noise."""
    random = np.random.default_rng(seed)
    noise = NOISE * random.standard_normal(recording.torque.shape)
    return Recording.from_arrays(
        recording.time + start, recording.position, hidden + noise, source=f"again {seed}"
    )


@pytest.fixture
def shivering(training_recording):
    """What no feature of the motion foretells: each 10 ms of the motion has a torque of its own."""
    random = np.random.default_rng(7)
    steps = random.standard_normal(training_recording.torque.shape)
    return 0.2 * np.apply_along_axis(np.convolve, 0, steps, np.ones(20) / 20, mode="same")


def test_the_same_motion_at_another_time_is_recognised(rigid, record, training_recording):
    other = record(2, 60.0)
    runs = [training_recording, other, later(training_recording, 3.217, 5)]
    observed = Observations.of(rigid, runs, 10.0)
    assert groups(observed) == ((0, 2),)
    (said,) = notes(observed)
    assert said.startswith("seed 1 and again 5 repeat one motion")


def test_a_part_of_a_motion_is_recognised(rigid, training_recording):
    late = later(training_recording, 0.0, 5)[1500:]
    observed = Observations.of(rigid, [training_recording, late], 10.0)
    assert groups(observed) == ((0, 1),)
    _, count = foretold_by_repeats(observed, observed.residual)
    time = observed.slow.time[(observed.recording == 0) & (count > 0)]
    assert 14.9 < time.min() < 15.6
    assert time.max() > 59


def test_the_same_path_backwards_or_slower_is_another_motion(rigid, training_recording):
    first = training_recording
    backwards = replace(later(first, 0.0, 5), position=first.position[::-1].copy())
    slower = replace(later(first, 0.0, 6), time=1.2 * first.time)
    for other in (backwards, slower):
        assert groups(Observations.of(rigid, [first, other], 10.0)) == ()


def test_a_recording_alone_foretells_nothing(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording], 10.0)
    values, count = foretold_by_repeats(observed, observed.residual)
    assert not count.any()
    assert not values.any()
    assert list(notes(observed)) == []


def test_what_comes_again_is_foretold_though_no_black_box_can(rigid, training_recording, shivering):
    runs = [later(training_recording, 0.0, k, shivering) for k in (5, 6)]
    alone = Observations.of(rigid, runs[:1], 10.0)
    both = Observations.of(rigid, runs, 10.0)
    left = [o.measured - o.filter(np.zeros_like(o.motion.position)) for o in (alone, both)]
    blind, seen = leftover(alone, left[0]), leftover(both, left[1])
    noise = both.filter(np.concatenate([run.torque - shivering for run in runs]))
    floor = np.sqrt(np.mean(noise**2, axis=0))
    assert seen.floor == pytest.approx(floor, rel=0.1)
    assert np.all(blind.floor > 3 * floor)
    assert seen.foretellable.all()


def test_noise_that_does_not_come_again_is_no_rest(rigid, training_recording):
    runs = [later(training_recording, 0.0, k) for k in (5, 6)]
    observed = Observations.of(rigid, runs, 10.0)
    assert not leftover(observed, observed.measured).foretellable.any()


def test_a_gap_in_one_recording_is_not_filled_from_its_sides(rigid, training_recording):
    again = later(training_recording, 0.0, 5)
    kept = (again.time < 20) | (again.time > 24)
    observed = Observations.of(rigid, [training_recording, again[kept]], 10.0)
    _, count = foretold_by_repeats(observed, observed.residual)
    inside = (observed.recording == 0) & (np.abs(observed.slow.time - 22) < 1.8)
    assert inside.any()
    assert not count[inside].any()
    assert (count[observed.recording == 0] > 0).mean() > 0.85
