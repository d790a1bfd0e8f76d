"""When the next state is due, and where that is not worth waiting for."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.service.inference.forecast import Forecast

MS = 1e-3  # [s]


def fed(forecast, rate, count, *, jitter=0.0, first=0.0, clock=7.0, seed=0):
    """Take states that come 1 ms after their stamps, or up to `jitter` later; return the latest."""
    late = np.random.default_rng(seed).uniform(0.0, jitter, count)
    stamps = first + np.arange(count) / rate
    for stamp, more in zip(stamps, late, strict=True):
        forecast.came(round(1e9 * stamp), clock + stamp + MS + more)
    return stamps[-1]


def test_the_next_state_is_due_as_long_after_the_last_as_they_are_apart():
    forecast = Forecast()
    last = fed(forecast, 100.0, 50)
    assert forecast.due.period == pytest.approx(10 * MS)
    assert forecast.due.begin == pytest.approx(7.0 + last + 11 * MS)
    assert forecast.due.end == pytest.approx(7.0 + last + 11 * MS)


def test_it_begins_earlier_by_what_waking_and_a_rehearsal_take():
    forecast = Forecast()
    forecast.woke(0.2 * MS)
    forecast.rehearsed(0.5 * MS)
    last = fed(forecast, 100.0, 50, jitter=0.3 * MS)
    due = forecast.due
    assert due.begin == pytest.approx(7.0 + last + 11 * MS - 0.7 * MS, abs=0.1 * MS)
    assert due.end == pytest.approx(7.0 + last + 11.3 * MS, abs=0.1 * MS)


def test_nothing_is_known_of_a_few_states():
    forecast = Forecast()
    fed(forecast, 100.0, 10)
    assert forecast.due is None


@pytest.mark.parametrize("rate", [400.0, 1000.0, 5000.0])
def test_states_that_come_fast_are_not_awaited(rate):
    forecast = Forecast()
    fed(forecast, rate, 1000)
    assert forecast.due is None


@pytest.mark.parametrize(("rate", "awaited"), [(10.0, True), (50.0, True), (200.0, False)])
def test_nor_are_those_that_leave_no_room_for_a_rehearsal(rate, awaited):
    forecast = Forecast()
    forecast.rehearsed(0.7 * MS)
    fed(forecast, rate, 60)
    assert (forecast.due is not None) == awaited


@pytest.mark.parametrize(("jitter", "awaited"), [(0.5, True), (4.0, False)])
def test_nor_are_those_that_come_when_they_will(jitter, awaited):
    forecast = Forecast()
    fed(forecast, 100.0, 60, jitter=jitter * MS)
    assert (forecast.due is not None) == awaited


def test_no_more_than_a_tenth_of_the_time_is_spent_awake():
    forecast = Forecast()
    forecast.rehearsed(0.5 * MS)
    last = fed(forecast, 100.0, 60, jitter=0.8 * MS)
    for k in range(8):  # some of which come much later
        last += 10 * MS
        forecast.came(round(1e9 * last), 7.0 + last + (1 + 4 * (k % 2)) * MS)
    assert forecast.due.end - forecast.due.begin <= 1.0 * MS + 1e-9


def test_a_machine_that_was_slow_is_tried_again():
    forecast = Forecast()
    for _ in range(3):
        forecast.rehearsed(2 * MS)
    last = fed(forecast, 100.0, 250)
    assert forecast.due is None
    fed(forecast, 100.0, 100, first=last + 0.01)
    assert forecast.due is not None


def test_a_rate_that_changes_is_followed():
    forecast = Forecast()
    last = fed(forecast, 100.0, 60)
    last = fed(forecast, 50.0, 30, first=last + 0.02)
    assert forecast.due.period == pytest.approx(20 * MS)
    assert forecast.due.end == pytest.approx(7.0 + last + 21 * MS)
    fed(forecast, 1000.0, 60, first=last + 0.001)
    assert forecast.due is None


def test_a_clock_that_is_set_back_begins_anew():
    forecast = Forecast()
    fed(forecast, 100.0, 60, first=100.0)
    last = fed(forecast, 100.0, 5, clock=107.0)
    assert forecast.due is None
    last = fed(forecast, 100.0, 30, first=last + 0.01, clock=107.0)
    assert forecast.due.begin == pytest.approx(107.0 + last + 11 * MS)


def test_a_state_that_came_again_says_nothing():
    forecast = Forecast()
    last = fed(forecast, 100.0, 60)
    due = forecast.due
    forecast.came(round(1e9 * last), 7.0 + last + 9 * MS)
    assert forecast.due is due
