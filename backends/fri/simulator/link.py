"""A network that loses, delays, reorders and doubles datagrams, the same ones for the same seed.

The fate of a datagram depends on the seed, the direction and its number in that direction alone,
and on what the scenario asks for at that time; not on when other datagrams came.
"""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass
from typing import Final

_NANO: Final = 1e9


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of datagrams in one direction."""

    loss: float = 0.0  # fraction that is lost
    delay: float = 0.0  # [s]
    jitter: float = 0.0  # [s], up to which more delay is added, evenly distributed
    reorder: float = 0.0  # fraction that is overtaken by the next one
    duplicate: float = 0.0  # fraction that comes twice


UNDISTURBED: Final = Disturbance()


@dataclass
class Fates:
    """Counts of datagrams by what happened to them."""

    passed: int = 0
    lost: int = 0
    delayed: int = 0
    reordered: int = 0
    duplicated: int = 0


class Channel:
    """One direction of the network.

    Args:
        name: Of the direction.
        seed: Of its fates.
    """

    def __init__(self, name: str, seed: int) -> None:
        self.fates = Fates()
        self._random = random.Random(f"{seed}/{name}")  # noqa: S311  # no secret
        self._waiting: list[tuple[int, int, bytes]] = []  # due [ns], number, datagram
        self._overtaken: list[bytes] = []
        self._number = 0

    @property
    def empty(self) -> bool:
        """Whether nothing is under way."""
        return not self._waiting and not self._overtaken

    def next_ns(self) -> int | None:
        """Return when the next datagram is due; None if there is none."""
        return self._waiting[0][0] if self._waiting else None

    def put(self, datagram: bytes, now_ns: int, disturbance: Disturbance) -> None:
        """Let a datagram go on its way."""
        lost, more, overtaken, twice = (self._random.random() for _ in range(4))
        if lost < disturbance.loss:
            self.fates.lost += 1
            return
        delay = disturbance.delay + more * disturbance.jitter
        self.fates.delayed += delay > 0
        if overtaken < disturbance.reorder and not self._overtaken:
            self.fates.reordered += 1
            self._overtaken.append(datagram)
            return
        due = now_ns + round(delay * _NANO)
        self._enqueue(due, datagram)
        if twice < disturbance.duplicate:
            self.fates.duplicated += 1
            self._enqueue(due, datagram)
        if self._overtaken:
            self._enqueue(due, self._overtaken.pop())

    def take(self, now_ns: int) -> list[tuple[bytes, int]]:
        """Return the datagrams that are due by now, in order, and when each was due [ns]."""
        due: list[tuple[bytes, int]] = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            at, _, datagram = heapq.heappop(self._waiting)
            due.append((datagram, at))
        self.fates.passed += len(due)
        return due

    def _enqueue(self, due_ns: int, datagram: bytes) -> None:
        heapq.heappush(self._waiting, (due_ns, self._number, datagram))
        self._number += 1
