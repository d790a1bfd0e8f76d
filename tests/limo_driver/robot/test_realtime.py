"""The loop of a millisecond: absolute times, what it asks of the machine, and giving it back."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest

from limo_driver.errors import ConfigError
from limo_driver.robot.realtime import (
    PRIORITY,
    YOUNG_LIMIT,
    Pace,
    Realtime,
    RealtimeThreads,
    sleeper,
)
from limo_driver.runtime.processes import command_of

pytestmark = pytest.mark.waits


def test_wakes_come_at_absolute_times() -> None:
    pace = Pace(2e-3)
    pace.wait()
    first, skipped = pace.due_ns, pace.skipped
    for _ in range(20):
        pace.wait()
        assert time.monotonic_ns() >= pace.due_ns
        assert (pace.due_ns - first) % pace.period_ns == 0
    assert pace.due_ns - first == (20 + pace.skipped - skipped) * pace.period_ns
    assert pace.lateness.count == 21


def test_a_loop_that_overran_leaves_periods_out() -> None:
    pace = Pace(1e-3)
    pace.wait()
    first, skipped = pace.due_ns, pace.skipped
    time.sleep(0.02)
    pace.wait()
    assert pace.skipped - skipped >= 18
    assert pace.due_ns - first == (1 + pace.skipped - skipped) * pace.period_ns
    assert "skipped" in pace.summary()


@pytest.mark.parametrize("period", [0.0, -1e-3, float("nan"), float("inf")])
def test_a_period_has_to_be_positive(period: float) -> None:
    with pytest.raises(ConfigError, match="has to be positive"):
        Pace(period)


def test_a_signal_does_not_shorten_a_sleep_unless_its_handler_raises() -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    handled = threading.Event()
    previous = signal.signal(signal.SIGALRM, lambda *_: handled.set())
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.02)
        due = time.monotonic_ns() + 60_000_000
        sleeper()(due)
        assert handled.is_set()
        assert time.monotonic_ns() >= due
        signal.signal(signal.SIGALRM, interrupt)
        with pytest.raises(KeyboardInterrupt):
            sleep_long_and_be_interrupted()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, previous)


def sleep_long_and_be_interrupted() -> None:
    signal.setitimer(signal.ITIMER_REAL, 0.02)
    sleeper()(time.monotonic_ns() + 600_000_000_000)


def test_the_collector_is_off_in_the_loop_and_garbage_stays_bounded() -> None:
    frozen = gc.get_freeze_count()
    with Realtime() as realtime:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > frozen
        for _ in range(3 * YOUNG_LIMIT):
            cycle: list[object] = []
            cycle.append(cycle)
            realtime.tidy()
        assert realtime.collections >= 2
        assert gc.get_count()[0] <= YOUNG_LIMIT + 1
        with Realtime():  # within another one, nothing is undone twice
            pass
        assert not gc.isenabled()
    assert gc.isenabled()


@pytest.mark.slow("starts processes")
def test_what_was_asked_of_the_machine_is_given_back_or_said_to_be_refused() -> None:
    slack = ctypes.CDLL(None).prctl
    policy, before = os.sched_getscheduler(0), slack(30, 0, 0, 0, 0)
    done = threading.Event()
    waiting = threading.Thread(target=done.wait, daemon=True)
    waiting.start()
    with Realtime(fifo=True) as realtime:
        permitted = os.sched_getscheduler(0) == os.SCHED_FIFO
        assert permitted != any("SCHED_FIFO" in text for text in realtime.refused)
        if permitted:  # the loop may have to wait for a lock that it holds
            assert os.sched_getparam(waiting.native_id).sched_priority == PRIORITY - 1
    assert os.sched_getscheduler(waiting.native_id) == os.sched_getscheduler(0) == policy
    done.set()
    assert slack(30, 0, 0, 0, 0) == before


@pytest.mark.slow("starts processes")
def test_threads_that_begin_late_are_in_real_time_and_processes_are_not(tmp_path: Path) -> None:
    (tmp_path / "tells_policy.py").write_text(
        "import os\ndef main(): print(os.sched_getscheduler(0))\n"
    )
    policies = list[int]()
    with RealtimeThreads() as threads:
        if threads.refused:
            pytest.skip(threads.refused[0])
        late = threading.Thread(target=lambda: policies.append(os.sched_getscheduler(0)))
        late.start()
        late.join()
        told = subprocess.run(
            command_of("tells_policy"),
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
    assert policies == [os.SCHED_FIFO]
    assert int(told.stdout) == os.SCHED_OTHER


def test_a_user_without_rights_is_told_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with Realtime(fifo=True) as realtime:
        (text,) = realtime.refused
    assert "rtprio" in text
    assert "Operation not permitted" in text
