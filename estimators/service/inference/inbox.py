"""States that wait to be answered: few, of one source, however many others send.

What comes waits in a ring in Rust, which a flood fills. Between any two answers all of it is taken
out and sorted: of the source that is followed, the latest few wait on, and the oldest of them go;
states of others are counted, and nothing of them is read. A sample may be there to wake who waits:
it is no state, and what comes while that one is awake is taken at once.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from estimators.service.inference.warmth import Warmth

RING: Final = 4096  # samples of anybody
WAITING: Final = 32  # states; older ones are lost rather than answered late


class Arrived(NamedTuple):
    """A state that waits, not yet read."""

    sample: zenoh.Sample
    source: str  # whose it is
    at: float  # [s] of this machine's clock


class Inbox:
    """The next state to be answered.

    Args:
        samples: Handler of a subscription, with a ring of `RING`.
        foreign: Says of a source, and counts, that it is not the one that is followed.
        warmth: What is done while the next state is awaited, once that is woken.
    """

    def __init__(
        self,
        samples: zenoh.Handler[zenoh.Sample],
        foreign: Callable[[str], bool],
        warmth: Warmth | None = None,
    ) -> None:
        self._samples, self._foreign, self._warmth = samples, foreign, warmth
        self._waiting: deque[Arrived] = deque(maxlen=WAITING)

    def next(self) -> Arrived:
        """Wait for a state, and return the oldest of those that still wait.

        Raises:
            zenoh.ZError: The subscription has ended.
        """
        waiting, samples = self._waiting, self._samples
        while True:
            if not waiting:
                self._wait()
            for _ in range(RING):  # a flood may come as fast as it is read
                if (sample := samples.try_recv()) is None:
                    break
                self._sort(sample, time.perf_counter())
            if waiting:
                return waiting.popleft()

    def _wait(self) -> None:
        woken = self._sort(self._samples.recv(), time.perf_counter())
        if woken and self._warmth is not None:
            sample, at = self._warmth.wait(self._samples.try_recv)
            if sample is not None:
                self._sort(sample, at)

    def _sort(self, sample: zenoh.Sample, at: float) -> bool:
        """Let a state wait, and say whether it is none, but a sample that wakes."""
        source = source_of(sample)
        if self._warmth is not None and source == self._warmth.alarm.source:
            return True
        if not self._foreign(source):
            self._waiting.append(Arrived(sample, source, at))
        return False


def source_of(sample: zenoh.Sample) -> str:
    """Return the identity of who sent a sample; empty where it does not say."""
    info = sample.source_info  # each time that it is asked for, it is made anew
    return "" if info is None else str(info.source_id)
