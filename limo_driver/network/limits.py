"""Answer queries only so often, however many come.

Zenoh does not say who asks, so nobody can be given a share of their own. What can be kept is the
stream: queries wait in a short ring, from which Zenoh's own threads drop the oldest, and one thread
takes as many of them as may be answered. A flood is dropped without a line of Python.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Final

import zenoh

from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

WAITING: Final = 32  # queries; older ones are dropped rather than answered late


class RateLimit:
    """Allows so many actions a second, and some at once.

    Args:
        rate: Actions in the long run [1/s].
        burst: Those that may come together.
        clock: Tells the time [s].
    """

    def __init__(
        self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, float(burst), clock
        self._left, self._then = self._burst, clock()

    def take(self) -> float:
        """Take the next action; return how long it has to wait [s], 0 if it need not."""
        now = self._clock()
        self._left = min(self._left + (now - self._then) * self._rate, self._burst) - 1.0
        self._then = now
        return max(0.0, -self._left / self._rate)


class PacedQueryable(Closing):
    """Answers queries on a key, one after the other, no more often than it may.

    Args:
        session: Open Zenoh session.
        key: Key expression of the queries.
        answer: Called with each query that is answered, on a thread of its own.
        rate: Queries that are answered in the long run [1/s].
        burst: Those that may come together.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        answer: Callable[[zenoh.Query], None],
        rate: float,
        burst: int,
    ) -> None:
        self._limit, self._answer = RateLimit(rate, burst), answer
        self._closed = threading.Event()
        self._queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(WAITING))
        self._thread = threading.Thread(
            target=self._serve, args=(self._queryable.handler,), name="limo-queries", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Answer no more; what is being answered is told to its end."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._queryable.undeclare()
        self._thread.join()

    def _serve(self, queries: zenoh.Handler[zenoh.Query]) -> None:
        while not self._closed.wait(self._limit.take()):
            try:
                query = queries.recv()
            except zenoh.ZError:  # undeclared
                return
            with query:
                self._answer(query)
