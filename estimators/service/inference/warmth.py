"""Keep what answers an arm warm: rehearse the answer just before the next state is due.

Where states come slowly, all code and data of an answer are in no cache any more when the next one
comes, and the answer takes three times as long; so does waking the thread that gives it. So that
thread is woken shortly before, rehearses, and looks for the state until it comes. What wakes it is
a sample that never leaves this process, in the one queue where states come: one thread takes both,
so that no state is overtaken. One that comes early waits for a part of a rehearsal at most, and
wins as much of its own answer by it.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

import zenoh

from limo_driver.errors import LimoError
from limo_driver.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from estimators.service.inference.forecast import Due, Forecast

_FRESH: Final = 5e-4  # [s] after which a rehearsal is forgotten by the caches of a shared core
_LONGEST: Final = 0.1  # [s] between looks at the forecast


class Alarm(Closing):
    """Wakes the thread that waits for states, by a sample among them that stays in this process.

    Args:
        session: That the states come from.
        key: On which they come.
        forecast: Of when the next one does.
    """

    def __init__(self, session: zenoh.Session, key: str, forecast: Forecast) -> None:
        self._forecast = forecast
        self._publisher = session.declare_publisher(
            key, allowed_destination=zenoh.Locality.SESSION_LOCAL
        )
        self._info = zenoh.SourceInfo(self._publisher.id, 0)
        self.source = str(self._publisher.id)  # by which its samples are known
        self.rung: Due | None = None  # for which it last woke
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._wait, name="limo-alarm", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Wake nobody any more."""
        self._closed.set()
        self._thread.join()
        self._publisher.undeclare()

    def _wait(self) -> None:
        pause = _LONGEST
        while not self._closed.wait(pause):
            due, now = self._forecast.due, time.perf_counter()
            if due is None or now > due.end + due.period:  # states no longer come
                pause = _LONGEST
            elif due is self.rung or now >= due.end:  # this one did not come yet, or it is too late
                pause = 0.5 * due.period
            elif now < due.begin:
                pause = min(due.begin - now, _LONGEST)
            else:
                self.rung = due
                try:
                    self._publisher.put(b"", source_info=self._info)
                except zenoh.ZError:  # closed
                    return
                pause = due.begin + due.period - time.perf_counter()


class Warmth:
    """Rehearses, once woken, until a state is there or will hardly come any more.

    Args:
        rehearse: Does all that is done for a state, part by part, without effect.
        forecast: Of when the next state comes.
        alarm: That wakes.
    """

    def __init__(
        self, rehearse: Callable[[], Iterator[None]], forecast: Forecast, alarm: Alarm
    ) -> None:
        self._rehearse, self._forecast, self.alarm = rehearse, forecast, alarm
        self._failed = False

    def wait(self, look: Callable[[], zenoh.Sample | None]) -> tuple[zenoh.Sample | None, float]:
        """Return the state that is due and when it came [s], or None where it did not.

        Args:
            look: Returns what has come, if anything has.
        """
        now, due = time.perf_counter(), self.alarm.rung
        if due is None or self._failed:
            return None, now
        self._forecast.woke(now - due.begin)
        if due is not self._forecast.due:  # which came before it was awaited
            return None, now
        while now < due.end:
            began = now
            for _ in self._parts():
                looked, now = now, time.perf_counter()
                if (sample := look()) is not None:
                    return sample, 0.5 * (looked + now)
            self._forecast.rehearsed(now - began)
            forgotten = now + _FRESH
            while now < min(forgotten, due.end):
                if (sample := look()) is not None:
                    return sample, now
                now = time.perf_counter()
        return None, now

    def _parts(self) -> Iterator[None]:
        """Rehearse part by part."""
        try:
            yield from self._rehearse()
        except LimoError:  # as the answer may, which then tells
            pass
        except Exception:  # noqa: BLE001  # of our own; the stream has to go on
            self._failed = True
        yield
