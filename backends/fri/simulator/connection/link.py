"""A network that loses, delays, reorders and doubles datagrams, the same ones for the same seed.

The fate of a datagram depends on the seed, the direction and its number in that direction alone,
and on what the scenario asks for at that time; not on when other datagrams came.
"""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass
from typing import Final, NamedTuple

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


class Delivered(NamedTuple):
    """A datagram that the network delivers."""

    data: bytes
    at_ns: int  # when it was due
    disturbed: bool  # it came later than it would have, overtaken or twice


class Channel:
    """One direction of the network.

    Args:
        name: Of the direction.
        seed: Of its fates.
    """

    def __init__(self, name: str, seed: int) -> None:
        self.fates = Fates()
        self._random = random.Random(f"{seed}/{name}")  # noqa: S311  # no secret
        self._waiting: list[tuple[int, int, Delivered]] = []  # due [ns], number
        self._overtaken: list[bytes] = []
        self._number = 0

    @property
    def empty(self) -> bool:
        """Whether nothing is under way."""
        return not self._waiting and not self._overtaken

    def next_ns(self) -> int | None:
        """Return when the next datagram is due; None if there is none."""
        return self._waiting[0][0] if self._waiting else None

    def put(self, datagram: bytes, now_ns: int, disturbance: Disturbance) -> bool:
        """Let a datagram go on its way; say whether anything happens to it."""
        lost, more, overtaken, twice = (self._random.random() for _ in range(4))
        if lost < disturbance.loss:
            self.fates.lost += 1
            return True
        delay = disturbance.delay + more * disturbance.jitter
        self.fates.delayed += delay > 0
        if overtaken < disturbance.reorder and not self._overtaken:
            self.fates.reordered += 1
            self._overtaken.append(datagram)
            return True
        due = now_ns + round(delay * _NANO)
        copied = twice < disturbance.duplicate
        disturbed = delay > 0 or copied
        self._enqueue(Delivered(datagram, due, disturbed))
        if copied:
            self.fates.duplicated += 1
            self._enqueue(Delivered(datagram, due, disturbed=True))
        if self._overtaken:
            self._enqueue(Delivered(self._overtaken.pop(), due, disturbed=True))
        return disturbed

    def take(self, now_ns: int) -> list[Delivered]:
        """Return the datagrams that are due by now, in order."""
        due: list[Delivered] = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            due.append(heapq.heappop(self._waiting)[2])
        self.fates.passed += len(due)
        return due

    def _enqueue(self, datagram: Delivered) -> None:
        heapq.heappush(self._waiting, (datagram.at_ns, self._number, datagram))
        self._number += 1
