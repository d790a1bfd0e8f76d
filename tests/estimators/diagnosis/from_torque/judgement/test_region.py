"""Region: where a torque has its energy is said, and nothing where it is spread over the motion."""

from __future__ import annotations

import re

import numpy as np
import pytest

from estimators.diagnosis.from_torque.judgement.surrogate import where_of
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.settings import MOST


@pytest.fixture(scope="module")
def observed(rigid, training_recording, test_recording):
    return Observations.of(rigid, [training_recording, test_recording], 10.0)


def test_a_torque_all_over_the_motion_has_no_region(observed):
    where = where_of(observed, np.ones(observed.kept.size), 1)
    assert where.region == "joint 2, all over the motion"
    assert (where.time, where.recording, where.figure) == ((), (), "joint-2")


def test_a_torque_of_creep_is_said_to_be_at_small_speeds(observed):
    speed = np.abs(observed.slow.velocity[:, 0])
    where = where_of(observed, np.exp(-speed / 0.01), 0)
    assert where.region.startswith("joint 1: at low speed (half of it below 0.0")
    assert "load" not in where.region
    assert where.time == ()


def test_a_torque_at_one_position_is_said_to_be_there(observed):
    position = observed.slow.position[:, 0]
    place = float(np.median(position))
    where = where_of(observed, np.exp(-(((position - place) / 0.005) ** 2)), 0)
    assert re.search(r"near one position \(.* between 0\.39\d and 0\.40\d rad", where.region)


@pytest.mark.parametrize("begins", [0.0, 10.0])
def test_a_brief_torque_is_said_with_its_recording_and_time(observed, begins):
    time = observed.slow.time
    brief = (observed.recording == 1) & (time >= begins) & (time < begins + 5.0)
    where = where_of(observed, brief.astype(float), 1)
    assert where.recording == (2,)
    ((start, end),) = where.time
    assert begins <= start < end <= begins + 5.0
    shown = brief & observed.moving[:, 1]
    inside = (time >= start) & (time <= end) & shown
    assert inside.sum() == np.ceil(MOST * shown.sum())
    assert start == time[shown][0]  # of stretches of one length the first
    assert "in a short part of the time" in where.region


def test_a_torque_in_both_recordings_has_a_stretch_in_each(observed):
    brief = (observed.slow.time > 5.0) & (observed.slow.time < 10.0)
    where = where_of(observed, brief.astype(float), 0)
    assert where.recording == (1, 2)
    assert all(4.9 < start < end < 10.1 for start, end in where.time)


def test_nothing_has_no_region(observed):
    assert where_of(observed, np.zeros(observed.kept.size), 0).region == "joint 1"
