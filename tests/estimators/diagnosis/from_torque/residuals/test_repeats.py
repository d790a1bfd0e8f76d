"""Repeats: recordings of one motion are recognised, and what they differ by is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.usable_joints import notes, repeats
from limo_driver.recordings.recording import Recording

NOISE = 0.02  # [N m], white, of which the filter keeps a part


def again(recording: Recording, start: float, seed: int, every: int = 1) -> Recording:
    """Record the motion again: on another clock, at another rate, with other noise."""
    random = np.random.default_rng(seed)
    noise = NOISE * random.standard_normal(recording.torque.shape)
    rows = slice(seed % every, None, every)
    return Recording.from_arrays(
        recording.time[rows] + start,
        recording.position[rows],
        (recording.torque + noise)[rows],
        source=f"again {seed}",
    )


def found(rigid, *recordings):
    observed = Observations.of(rigid, recordings, 10.0)
    return repeats(observed, observed.residual)


@pytest.mark.parametrize(("start", "every"), [(0.0, 1), (3.2173, 1), (-40.5, 2)])
def test_the_same_motion_at_another_time_and_rate_is_recognised(
    rigid, record, training_recording, start, every
):
    late = again(training_recording, start, 5, every)
    (pair,) = found(rigid, training_recording, record(2, 60.0), late)
    assert pair.recordings == (0, 2)
    assert pair.delay == pytest.approx(start, abs=1e-3)


def test_what_repeats_differ_by_is_the_noise_of_one(rigid, training_recording):
    runs = [again(training_recording, 1.7, k) for k in (5, 6)]
    (pair,) = found(rigid, *runs)
    clean = training_recording.filtered_torque(10.0)
    noise = np.concatenate([run.filtered_torque(10.0) - clean for run in runs])
    assert pair.apart == pytest.approx(np.sqrt(np.mean(noise**2, axis=0)), rel=0.1)


def test_a_part_of_a_motion_is_recognised(rigid, training_recording):
    (pair,) = found(rigid, again(training_recording, 0.0, 5)[1500:4800], training_recording)
    assert pair.delay == pytest.approx(0.0, abs=1e-3)


def test_other_motion_is_no_repeat(rigid, record, training_recording):
    first = training_recording
    position = first.position
    others = {
        "backwards": replace(again(first, 0.0, 5), position=position[::-1].copy()),
        "slower": replace(again(first, 0.0, 6), time=1.2 * first.time),
        "elsewhere": replace(again(first, 0.0, 7), position=position + np.array([0.0, 0.9])),
        "one joint still": replace(
            again(first, 0.0, 8), position=np.column_stack([position[:, 0], 0 * position[:, 1]])
        ),
        "another": record(2, 60.0),
    }
    for name, other in others.items():
        assert found(rigid, first, other) == (), name
        assert found(rigid, other, first) == (), name


def test_of_a_joint_that_stays_still_nothing_is_said(rigid, training_recording):
    position = training_recording.position.copy()
    position[:, 1] = 0.3
    still = replace(training_recording, position=position)
    (pair,) = found(rigid, still, again(still, 2.0, 5))
    assert np.isnan(pair.apart[1])
    assert np.isfinite(pair.apart[0])


def test_a_gap_in_one_recording_is_not_filled_from_its_sides(rigid, training_recording):
    late = again(training_recording, 0.0, 5)
    late = late[(late.time < 20) | (late.time > 24)]
    strange = (training_recording.time > 20.5) & (training_recording.time < 23.5)
    torque = training_recording.torque + 5.0 * strange[:, None]
    (pair,) = found(rigid, replace(training_recording, torque=torque), late)
    assert pair.apart.max() < NOISE


def test_the_reader_is_told_which_repeat_and_what_they_differ_by(rigid, training_recording):
    observed = Observations.of(rigid, [training_recording, again(training_recording, 3, 5)], 10.0)
    (said,) = notes(observed, observed.residual)
    assert said.startswith("seed 1 and again 5 repeat one motion.")
    assert "N m RMS off" in said
    alone = Observations.of(rigid, [training_recording], 10.0)
    assert list(notes(alone, alone.residual)) == []
