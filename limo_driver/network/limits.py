"""Answer nobody more often than a peer may ask."""

from __future__ import annotations

import time
from threading import Lock
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

_MOST_PEERS: Final = 256  # that are told apart; of more, those that asked longest ago are forgotten


class PeerLimits:
    """Allows each peer so many requests a second, and some at once.

    Args:
        rate: Requests of a peer that are answered in the long run [1/s].
        burst: Those that may come together.
        clock: Tells the time [s].
    """

    def __init__(
        self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, float(burst), clock
        self._left: dict[str, tuple[float, float]] = {}  # requests, and when that was [s]
        self._lock = Lock()
        self.refused = 0

    def admits(self, peer: str) -> bool:
        """Say whether a request of a peer is answered; peers that do not say who they are share."""
        now = self._clock()
        with self._lock:
            left, then = self._left.pop(peer, (self._burst, now))
            left = min(left + (now - then) * self._rate, self._burst)
            admitted = left >= 1.0
            self._left[peer] = (left - admitted, now)
            if len(self._left) > _MOST_PEERS:
                del self._left[next(iter(self._left))]
            self.refused += not admitted
        return admitted
