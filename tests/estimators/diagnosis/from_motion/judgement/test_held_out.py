"""Which motion is held out, and what a finding has to remove of its errors."""

from __future__ import annotations

import numpy as np
import pytest
from servo_arms import VELOCITY, commands, recorded

from estimators.diagnosis.from_motion.held_out import removes, resolution_of, split
from estimators.diagnosis.from_motion.verdict import _above


def moved(pace):
    """Return a recording of an arm that is where it is commanded."""
    time, command = commands(5.0, 100.0, pace)
    return recorded(time, command, command)


def test_the_fastest_motion_is_fitted_to():
    recordings = [moved(pace) for pace in (1.0, 0.8, 0.6, 0.5)]

    assert split(recordings[::-1]) == (recordings[0::2], recordings[1::2])
    assert split(recordings) == (recordings[0::2], recordings[1::2])


def test_the_step_of_an_encoder_is_told_though_its_wheel_turns_by_many_in_each_row():
    time, step = np.arange(3000) / 50.0, 2 * np.pi / 4096
    speed = np.random.default_rng(0).uniform(12.0, 18.0, 3000) * np.sign(np.sin(time))
    turned = np.round(np.cumsum(speed[:, None] / 50.0 * [1.0, 1.1], axis=0) / step) * step
    rows = np.abs(np.diff(turned, axis=0)).min()

    recording = recorded(time, np.stack([speed, 1.1 * speed], axis=1), turned, VELOCITY)

    assert rows > 100 * step
    assert resolution_of([recording], 0) == pytest.approx(step)


@pytest.mark.parametrize(("part", "above"), [(0.9, []), (1.1, [0, 1])])
def test_an_error_within_a_step_of_the_encoder_is_none(part, above):
    """Of a simulation of the very arm: where its motion starts is known to a step."""
    recording, step = moved(1.0), np.full(2, 2 * np.pi / 4096)
    errors = np.full((len(recording), 2), part * step)
    assert _above(errors, [recording], step).tolist() == above
    assert _above(errors, [recording], 0 * step).tolist() == []


def test_few_recordings_are_cut_where_they_are_slowest():
    time = np.arange(600) / 100.0
    command = np.stack([np.where(abs(time - 2.5) < 0.3, 0.0, time - 2.5)] * 2, axis=1)
    first, second = (recorded(time, command + offset, command + offset) for offset in (0.0, 0.1))

    seen, unseen = split([first, second])

    for own, other in zip(seen, unseen, strict=True):
        assert 2.2 < own.time[-1] < 2.8
        assert len(own) + len(other) == len(time)


def test_confidence_is_how_often_a_finding_removes_a_tenth():
    rng = np.random.default_rng(0)
    without = rng.normal(size=4000) ** 2
    once = without.copy()
    once[:200] *= 0.1  # one of the blocks

    assert removes(0.5 * without, without) == 0.99
    assert removes(0.95 * without, without) == 0.0
    assert removes(without, without) == 0.0
    assert removes(once, without) < 0.3


def test_what_one_part_alone_shows_is_surer_on_all_parts():
    rng = np.random.default_rng(1)
    without = rng.normal(size=8000) ** 2
    shown = without.copy()
    shown[:4000] *= np.repeat(np.where(np.arange(20) % 2, 1.6, 0.1), 200)
    shown[4000:] *= 0.5

    first = removes(shown[:4000], without[:4000])

    assert 0.5 < first < removes(shown, without, 2)
