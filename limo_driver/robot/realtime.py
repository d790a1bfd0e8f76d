"""Real-time loops at 1 kHz: absolute wake-up times, scheduling priority, garbage collection.

    with Realtime(fifo=True) as realtime:
        pace = Pace(period=1e-3)
        while ...:
            pace.wait()
            ...
            realtime.tidy()
    print(pace.summary())

What the machine does not permit is left out, and said in `Realtime.refused`.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import math
import os
import resource
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.processes import Closing

PRIORITY: Final = 40  # of SCHED_FIFO: above all that is not real time, below the kernel's 50
_OTHERS: Final = PRIORITY - 1  # of other threads of a loop
_BEHIND: Final = PRIORITY - 2  # of what answers
YOUNG_LIMIT: Final = 5000  # containers that may wait for the collector while it is off
_NANO: Final = 1_000_000_000
_ON_LINUX: Final = sys.platform.startswith("linux")
_CLOCK_MONOTONIC, _ABSOLUTE = 1, 1  # of Linux
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30
_FINE_SLACK: Final = 1  # [ns]; the kernel adds up to 50 µs to every sleep otherwise
_LOWEST: Final = 1e-6  # [s]
_PER_DECADE: Final = 50  # bins; a percentile is good to 5 %
_BINS: Final = 8 * _PER_DECADE  # up to 100 s


class Pace:
    """Wakes at absolute times, a period apart, and counts how late.

    A loop that is late by whole periods leaves those out, so that it never hurries after lost time;
    they are counted as `skipped`.

    Args:
        period: Time between two wakes [s].
    """

    def __init__(self, period: float) -> None:
        if not 0 < period < float("inf"):
            raise ConfigError(f"period = {period} s has to be positive")
        self.period_ns: Final = round(period * _NANO)
        self.lateness: Final = LatencyHistogram()
        self.skipped = 0
        self.due_ns = 0  # of the last wake, on CLOCK_MONOTONIC
        self._sleep: Final = sleeper()

    def wait(self) -> int:
        """Sleep until the next wake is due; the first is at once.

        Returns:
            How late it is [ns].
        """
        due = self.next_ns()
        self._sleep(due)
        late = time.monotonic_ns() - due
        if late >= self.period_ns:
            missed = late // self.period_ns
            self.skipped += missed
            due += missed * self.period_ns
        self.due_ns = due
        self.lateness.add(1e-9 * late)
        return late

    def next_ns(self) -> int:
        """Return when the next wake is due, on CLOCK_MONOTONIC."""
        return self.due_ns + self.period_ns if self.due_ns else time.monotonic_ns()

    def summary(self) -> str:
        """Return how late the wakes were, in one line."""
        skipped = f", {self.skipped} skipped" if self.skipped else ""
        return f"{self.lateness.count} wakes, late by {self.lateness.summary()}{skipped}"


class _Asked(Closing):
    """What was asked of the machine; `close` puts everything back as it was."""

    def __init__(self) -> None:
        self.refused: list[str] = []
        self._undo: list[Callable[[], None]] = []

    def close(self) -> None:
        """Put everything back as it was."""
        while self._undo:
            self._undo.pop()()


class Realtime(_Asked):
    """Keeps the process ready for a loop: what there is by now is frozen, the collector is off.

    Only cycles of references wait for the collector; `tidy` collects the young ones when there are
    too many, in well under a millisecond, so that memory stays bounded. `close` undoes everything.

    Args:
        fifo: Ask for SCHED_FIFO and pages that stay in memory. The calling thread comes before the
            others, for whose lock of the interpreter or of the network it may have to wait; those
            that it starts are like it.
    """

    def __init__(self, *, fifo: bool = False) -> None:
        super().__init__()
        self.collections = 0
        self._freeze()
        self._fine_timers()
        if fifo:
            self._undo += _prefer_all(PRIORITY, _OTHERS, self.refused)

    def tidy(self) -> None:
        """Collect young garbage if there is much of it; call it where a cycle has time left."""
        if gc.get_count()[0] > YOUNG_LIMIT:
            gc.collect(0)
            self.collections += 1

    def _freeze(self) -> None:
        if not gc.isenabled():  # an outer loop has done so
            return
        gc.collect()
        gc.freeze()
        gc.disable()
        self._undo += [gc.enable, gc.unfreeze]

    def _fine_timers(self) -> None:
        if not _ON_LINUX:
            return
        libc = _libc()
        before = libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
        if libc.prctl(_PR_SET_TIMERSLACK, _FINE_SLACK, 0, 0, 0) == 0:
            self._undo.append(lambda: libc.prctl(_PR_SET_TIMERSLACK, max(before, 0), 0, 0, 0))


class RealtimeThreads(_Asked):
    """Puts all threads that a process has by now under SCHED_FIFO, and locks its memory.

    A loop that commands an arm comes before them. Threads that they start are like them; a process
    that they start leaves real time itself, `runtime.processes.leave_real_time`.
    """

    def __init__(self) -> None:
        super().__init__()
        self._undo += _prefer_all(_BEHIND, _BEHIND, self.refused)


def _prefer_all(own: int, others: int, refused: list[str]) -> list[Callable[[], None]]:
    """Put all threads under SCHED_FIFO, the calling one first, and lock memory.

    Threads of one interpreter wait for each other's lock, so one that is left out would hold the
    others up.

    Args:
        own: Priority of the calling thread.
        others: Of all others.
        refused: Gets what is not permitted.

    Returns:
        What takes it back.
    """
    if not _ON_LINUX:
        refused.append("SCHED_FIFO and locked memory are for Linux only")
        return []
    calling = threading.get_native_id()
    rest = {int(name) for name in os.listdir("/proc/self/task")} - {calling}
    undo = list[Callable[[], None]]()
    for thread in (calling, *rest):
        priority = own if thread == calling else others
        undo += _prefer(thread, priority, refused)
        if refused:
            return undo
    return undo + _lock_memory(refused)


def _prefer(thread: int, priority: int, refused: list[str]) -> list[Callable[[], None]]:
    """Put a thread under SCHED_FIFO; return what takes it back."""
    try:
        policy, parameters = os.sched_getscheduler(thread), os.sched_getparam(thread)
        os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
    except ProcessLookupError:  # it has ended
        return []
    except OSError as error:
        refused.append(
            f"SCHED_FIFO {priority} was not permitted ({error.strerror}): run as root, or give "
            "the user `rtprio` in /etc/security/limits.conf; scheduled as any other process"
        )
        return []

    def take_back() -> None:
        with suppress(ProcessLookupError):  # it has ended since
            os.sched_setscheduler(thread, policy, parameters)

    return [take_back]


def _lock_memory(refused: list[str]) -> list[Callable[[], None]]:
    """Keep all pages in memory; return what takes it back."""
    libc = _libc()
    endless = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] == resource.RLIM_INFINITY
    # With a limit, memory asked for later would be refused when the limit is reached.
    flags = _MCL_CURRENT | (_MCL_FUTURE if endless or os.geteuid() == 0 else 0)
    if libc.mlockall(flags):
        refused.append(
            f"memory was not locked ({os.strerror(ctypes.get_errno())}): give the user "
            "`memlock unlimited` in /etc/security/limits.conf; pages may be swapped out"
        )
        return []
    return [libc.munlockall]


def excuse(late: float) -> str:
    """Say, behind the reason of a hold, how late this program came [s], and what helps."""
    fifo = _ON_LINUX and os.sched_getscheduler(0) == os.SCHED_FIFO
    helps = "leave it this computer" if fifo else "give it real-time priority (limo run --fifo)"
    return f"; this program itself came {late:.3g} s late: {helps}"


def sleeper() -> Callable[[int], None]:
    """Return a function that sleeps until a time on CLOCK_MONOTONIC [ns], for one thread.

    An absolute time is kept also if the process is set aside on its way to sleep. Signals are
    handled meanwhile, and what their handlers raise goes through.
    """
    if not _ON_LINUX:
        return _sleep_relative
    until = (ctypes.c_long * 2)()  # struct timespec: seconds, nanoseconds
    nanosleep, address = _libc().clock_nanosleep, ctypes.addressof(until)
    nanosleep.argtypes = (ctypes.c_int, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)

    def sleep(due_ns: int, until: Any = until) -> None:  # noqa: ANN401  # kept alive with it
        until[0], until[1] = divmod(due_ns, _NANO)
        while nanosleep(_CLOCK_MONOTONIC, _ABSOLUTE, address, None) == errno.EINTR:
            pass

    return sleep


def _sleep_relative(due_ns: int) -> None:
    time.sleep(max(due_ns - time.monotonic_ns(), 0) / _NANO)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)


class LatencyHistogram:
    """Counts durations in bins of equal ratio from 1 µs to 100 s."""

    def __init__(self) -> None:
        self._counts = [0] * _BINS
        self.longest = 0.0  # [s]

    def add(self, duration: float) -> None:
        """Count a duration [s]; what is below 1 µs counts as that."""
        bin_ = int(_PER_DECADE * math.log10(duration / _LOWEST)) if duration > _LOWEST else 0
        self._counts[bin_ if bin_ < _BINS else -1] += 1
        self.longest = max(self.longest, duration)

    @property
    def count(self) -> int:
        """Durations counted."""
        return sum(self._counts)

    def percentile(self, percent: float) -> float:
        """Return the upper edge of the bin that holds a percentile [s]; NaN if there is none."""
        if not self.count:
            return float("nan")
        reached = np.cumsum(self._counts) >= percent / 100.0 * self.count
        edge = 1 + int(np.argmax(reached))
        return min(float(_LOWEST * 10.0 ** (edge / _PER_DECADE)), self.longest)

    def take(self) -> LatencyHistogram:
        """Return what was counted, and begin anew."""
        taken = LatencyHistogram()
        taken._counts, self._counts = self._counts, [0] * _BINS
        taken.longest, self.longest = self.longest, 0.0
        return taken

    def summary(self) -> str:
        """Return percentiles as text [ms]."""
        if not self.count:
            return "none counted"
        return (
            f"p50 {1e3 * self.percentile(50):.3f}, p99 {1e3 * self.percentile(99):.3f}, "
            f"p99.9 {1e3 * self.percentile(99.9):.3f}, longest {1e3 * self.longest:.3f} ms"
        )

    def as_json(self) -> dict[str, Any]:
        """Return percentiles [s] and the counts per decade, as JSON values."""
        if not self.count:
            return {"count": 0}
        return {
            "count": self.count,
            **{f"p{p:g}".replace(".", "_"): self.percentile(p) for p in (50, 99, 99.9)},
            "longest": self.longest,
            "counts": list(self._counts),
        }
