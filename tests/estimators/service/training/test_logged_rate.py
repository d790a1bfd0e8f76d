"""Logs that hold more than one motion: other rates, clocks that were set back, other times."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
import pytest

from estimators.service.retraining.logged_motion import LoggedRates, Span, newest_motion
from limo_driver.errors import RecordingError
from limo_driver.logs.mcap_file import LoggedMessage
from limo_driver.logs.mcap_log import LogLimits, McapLog
from limo_driver.network.messages import JOINT_STATE, JointStateCodec

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

NAMES = ("a", "b")
TOPIC = "limo/arm/state/joints"
START = 1_700_000_000_000_000_000  # [ns]
SECOND = 1_000_000_000  # [ns]


def stamps_at(rate: float, first: float, seconds: float) -> NDArray[np.int64]:
    return START + np.round(1e9 * (first + np.arange(int(seconds * rate)) / rate)).astype(np.int64)


def rates_of(*runs: NDArray[np.int64], lost: float = 0.0) -> LoggedRates:
    """Take runs of states, each numbered from 0."""
    rates, random = LoggedRates(TOPIC), np.random.default_rng(1)
    for run in runs:
        for number, stamp in enumerate(run):
            if random.random() >= lost:
                when = int(stamp)
                rates.take(LoggedMessage(TOPIC, JOINT_STATE, b"", when, when, number))
    return rates


class TestRates:
    def test_are_told_apart_also_where_nothing_lies_between(self) -> None:
        slow, fast = stamps_at(100.0, 0.0, 10.0), stamps_at(250.0, 10.0, 10.0)
        rates = rates_of(np.r_[slow, fast])
        assert rates.newest(np.r_[slow, fast]) == pytest.approx(250.0)
        assert rates.of_rate(slow, 100.0).mean() > 0.85
        assert not rates.of_rate(fast, 100.0).any()
        assert not rates.of_rate(slow, 250.0).any()

    def test_half_of_the_states_lost_is_no_other_rate(self) -> None:
        stamps = stamps_at(1000.0, 0.0, 5.0)
        assert rates_of(stamps, lost=0.5).newest(stamps) == pytest.approx(1000.0, rel=1e-3)

    def test_uneven_stamps_are_none_either(self) -> None:
        stamps, found = stamps_at(1000.0, 0.0, 5.0), LoggedRates(TOPIC)
        uneven = stamps + np.random.default_rng(0).normal(0, 5e4, stamps.size).astype(int)
        for number, stamp in enumerate(np.sort(uneven)):
            found.take(LoggedMessage(TOPIC, JOINT_STATE, b"", int(stamp), int(stamp), number))
        assert found.of_rate(uneven, 1000.0).mean() > 0.95

    def test_of_nothing_are_not_known(self) -> None:
        nothing = np.empty(0, dtype=np.int64)
        assert np.isnan(LoggedRates(TOPIC).newest(nothing))
        one = stamps_at(100.0, 0.0, 0.01)
        assert not rates_of(one).of_rate(one, 100.0).any()

    def test_a_clock_that_was_set_back_is_found(self) -> None:
        first, second = stamps_at(100.0, 0.0, 10.0), stamps_at(100.0, 6.0, 20.0)
        twice = rates_of(first, second).twice(np.r_[first, second])
        np.testing.assert_array_equal(twice[:1000], first >= START + 6 * SECOND)
        np.testing.assert_array_equal(twice[1000:], second < START + 10 * SECOND)


def write(folder: Path, *runs: NDArray[np.int64]) -> None:
    """Log runs of motion, each in a file of its own, with positions that say which."""
    codec = JointStateCodec(NAMES, "arm")
    for which, run in enumerate(runs):
        with McapLog(folder, "arm", LogLimits(queue=1_000_000)) as log:
            for number, stamp in enumerate(run.tolist()):
                moved = 0.1 * np.sin(0.01 * number + np.arange(2)) + which
                payload = codec.encode(stamp, moved, 0 * moved, np.cos(0.1 * number) * moved)
                log.write(TOPIC, JOINT_STATE, payload, stamp, stamp, number)


class TestMotion:
    @pytest.mark.slow("writes and reads logs for seconds")
    def test_at_another_rate_is_left_out(self, tmp_path: Path) -> None:
        write(tmp_path, stamps_at(250.0, 0.0, 8.0), stamps_at(100.0, 10.0, 20.0))
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0))
        assert motion.recording.rate == pytest.approx(100.0)
        assert motion.recording.position.min() > 0.8
        assert motion.origin["other_rate_samples"] == 2000
        older = newest_motion(tmp_path, "arm", NAMES, Span(60.0, rate=250.0))
        assert older.recording.position.max() < 0.2
        with pytest.raises(RecordingError, match="no joint states at 500 Hz"):
            newest_motion(tmp_path, "arm", NAMES, Span(60.0, rate=500.0))

    def test_of_two_runs_at_one_time_is_left_out(self, tmp_path: Path) -> None:
        write(tmp_path, stamps_at(100.0, 0.0, 10.0), stamps_at(100.0, 9.9, 20.0))
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0))
        steps = np.abs(np.diff(motion.recording.position[:, 0]))
        assert (steps > 0.5).sum() == 1  # from one run to the other, never to and fro
        assert len(motion.recording) < 2990

    def test_from_a_future_that_has_not_come_is_left_out(self, tmp_path: Path) -> None:
        write(tmp_path, stamps_at(100.0, 3600.0, 30.0), stamps_at(100.0, 0.0, 10.0))
        now = int(stamps_at(100.0, 0.0, 10.0)[-1])
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0, until_ns=now))
        assert motion.origin["end_ns"] == now
        assert motion.recording.position.min() > 0.8

    def test_that_ended_long_ago_is_not_learned_as_new(self, tmp_path: Path) -> None:
        write(tmp_path, stamps_at(100.0, 0.0, 10.0))
        now = START + 600 * SECOND
        with pytest.raises(RecordingError, match=r"end 590 s before the newest .*log stopped"):
            newest_motion(tmp_path, "arm", NAMES, Span(60.0, until_ns=now))

    def test_in_old_files_is_not_read(self, tmp_path: Path) -> None:
        write(tmp_path, stamps_at(100.0, 0.0, 5.0), stamps_at(100.0, 6.0, 10.0))
        first, second = sorted(tmp_path.glob("*.mcap"))
        long_ago = second.stat().st_mtime - 1000.0
        os.utime(first, (long_ago, long_ago))
        motion = newest_motion(tmp_path, "arm", NAMES, Span(60.0))
        assert motion.origin["logs"] == [second.name]
