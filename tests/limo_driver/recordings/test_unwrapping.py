"""Positions that count on at the other end of their encoder's range."""

import numpy as np
import pytest

from limo_driver import Recording
from limo_driver.recordings.channels import unwrapped

TIME = np.arange(0.0, 20.0, 0.005)  # [s]
TURN = 2 * np.pi


def wrapped(position, period=TURN, start=-np.pi):
    return (position - start) % period + start


@pytest.mark.parametrize("start", [-np.pi, 0.0])
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize(
    "motion",
    [2.0 * TIME, 4.0 * np.sin(TIME), 30.0 * np.sin(0.2 * TIME), -5.0 * TIME + np.sin(3 * TIME)],
    ids=["on", "there and back", "turns there and back", "down"],
)
def test_turns_are_counted_on(motion, noise, start):
    motion = motion + np.random.default_rng(0).normal(0.0, noise, TIME.size)
    found = unwrapped(wrapped(motion, start=start))
    assert found is not None
    assert found.period == TURN
    away = (found.position - motion) / TURN
    assert np.ptp(away) == pytest.approx(0.0, abs=1e-9)


def test_an_encoder_before_a_gear_wraps_by_any_angle():
    motion = 1.5 * np.sin(0.5 * TIME)
    found = unwrapped(wrapped(motion, period=0.9, start=-0.2))
    assert found is not None
    assert found.period == pytest.approx(0.9, rel=1e-3)
    assert np.abs(np.diff(found.position - motion)).max() < 1e-3


def lost(position, rows, value=0.0):
    position = position.copy()
    position[rows] = value
    return position


@pytest.mark.parametrize(
    "position",
    [
        np.sin(TIME),
        10.0 * TIME,
        lost(2.0 + 0.1 * np.sin(TIME), slice(700, 701)),
        lost(2.0 + 0.1 * np.sin(TIME), slice(700, 760)),
        lost(2.0 + 0.1 * np.sin(TIME), slice(700, None), 0.5),
        np.where(TIME < 10, 0.1 * TIME, 0.1 * TIME - 1.0),
        np.zeros(0),
        np.full(5, np.nan),
        np.array([0.0, 7.0]),
    ],
    ids=["bounded", "on", "one lost", "many lost", "ends", "slips", "none", "unknown", "two"],
)
def test_all_else_is_left_as_it_is(position):
    assert unwrapped(position) is None


def test_a_recording_says_what_was_counted_on():
    motion = np.stack([2.0 * TIME, np.sin(TIME)], axis=1)
    given = np.stack([wrapped(motion[:, 0]), motion[:, 1]], axis=1)
    recording = Recording.from_arrays(TIME, given, np.ones_like(given) + 0.01 * motion)
    assert "position_1 wraps 6 times by 6.283 rad; it is counted on" in recording.warnings
    np.testing.assert_allclose(recording.position, motion, atol=1e-9)
