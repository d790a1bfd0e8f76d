"""States that wait to be answered: few, of one source, however many others send.

What comes waits in a ring in Rust, which a flood fills. Between any two answers all of it is taken
out and sorted: of the source that is followed, the latest few wait on, and the oldest of them go;
states of others are counted, and nothing of them is read.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

RING: Final = 4096  # samples of anybody
WAITING: Final = 32  # states; older ones are lost rather than answered late


class Inbox:
    """The next state to be answered.

    Args:
        samples: Handler of a subscription, with a ring of `RING`.
        foreign: Says of a sample, and counts, that it is not of the source that is followed.
    """

    def __init__(
        self, samples: zenoh.Handler[zenoh.Sample], foreign: Callable[[zenoh.Sample], bool]
    ) -> None:
        self._samples, self._foreign = samples, foreign
        self._waiting: deque[zenoh.Sample] = deque(maxlen=WAITING)

    def next(self) -> zenoh.Sample:
        """Wait for a state, and return the oldest of those that still wait.

        Raises:
            zenoh.ZError: The subscription has ended.
        """
        waiting, samples = self._waiting, self._samples
        while True:
            if not waiting:
                self._sort(samples.recv())
            for _ in range(RING):  # a flood may come as fast as it is read
                if (sample := samples.try_recv()) is None:
                    break
                self._sort(sample)
            if waiting:
                return waiting.popleft()

    def _sort(self, sample: zenoh.Sample) -> None:
        if not self._foreign(sample):
            self._waiting.append(sample)
