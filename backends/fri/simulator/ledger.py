"""Count every datagram sent and received once: answered in time, late or lost.

One answer is expected in every receive interval from the first answer of a client on. It is in time
if it comes before the next interval begins and answers a packet of this one; late if it comes
later; lost if it never comes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final

from limo_driver.latency import LatencyHistogram

REMEMBERED: Final = 4096  # packets that can still be answered
_MODULUS: Final = 1 << 32  # of the counters
_NANO: Final = 1e-9


class Arrival(Enum):
    """Kind of an answer, by its counters."""

    IN_TIME = "in time"
    LATE = "late"
    REPEATED = "repeated"
    UNKNOWN = "unknown"

    @property
    def usable(self) -> bool:
        """Whether it answers a packet for the first time."""
        return self in {Arrival.IN_TIME, Arrival.LATE}


@dataclass
class Ledger:
    """Counts of one run.

    Args:
        multiplier: Packets in one receive interval.
        late_ns: Answers that took longer are counted as slow as well, None for none [ns].
    """

    multiplier: int
    late_ns: int | None = None
    sent: int = 0
    expected: int = 0
    unheard: int = 0  # intervals before the first answer of a client
    answered: int = 0
    in_time: int = 0
    late: int = 0
    slow: int = 0
    repeated: int = 0
    unknown: int = 0
    gaps: int = 0  # numbers missing in the client's own counter
    restarts: int = 0  # clients that began to count anew
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)
    answered_now: bool = False  # in this interval, in time

    def __post_init__(self) -> None:
        self._sent_at = [0] * REMEMBERED
        self._open = bytearray(REMEMBERED)  # whether a packet is still to be answered
        self._client_sequence: int | None = None
        self._heard = False
        self._in_interval = 0

    @property
    def lost(self) -> int:
        """Answers that never came."""
        return max(self.expected - self.answered, 0)

    @property
    def next_sequence(self) -> int:
        """Counter of the next packet."""
        return self.sent % _MODULUS

    def send(self, now_ns: int, *, expects_answer: bool) -> None:
        """Take note of a packet."""
        place = self.sent % REMEMBERED
        self._sent_at[place], self._open[place] = now_ns, expects_answer
        self.sent += 1
        self._in_interval += expects_answer

    def close_interval(self) -> bool | None:
        """End the receive interval if it is over; return whether it was answered in time."""
        if self._in_interval < self.multiplier:
            return None
        answered, self.answered_now, self._in_interval = self.answered_now, False, 0
        if self._heard:
            self.expected += 1
        else:
            self.unheard += 1
        return answered

    def receive(self, sequence: int, reflected: int, at_ns: int) -> Arrival:
        """Take note of an answer.

        Args:
            sequence: The client's own counter.
            reflected: Which packet it answers.
            at_ns: When it came, on the clock of `send` [ns].
        """
        self._heard = True
        self._count_client(sequence)
        age = (self.next_sequence - 1 - reflected) % _MODULUS
        place = (self.sent - 1 - age) % REMEMBERED
        if age >= min(REMEMBERED, self.sent):
            self.unknown += 1
            return Arrival.UNKNOWN
        if not self._open[place]:
            self.repeated += 1
            return Arrival.REPEATED
        self._open[place] = False
        took = at_ns - self._sent_at[place]
        self.latency.add(took * _NANO)
        self.slow += self.late_ns is not None and took > self.late_ns
        self.answered += 1
        if age < max(self._in_interval, 1):
            self.in_time, self.answered_now = self.in_time + 1, True
            return Arrival.IN_TIME
        self.late += 1
        return Arrival.LATE

    def _count_client(self, sequence: int) -> None:
        before, self._client_sequence = self._client_sequence, sequence
        if before is None:
            return
        if sequence == 0 and before != _MODULUS - 1:
            self.restarts += 1
            return
        missing = (sequence - before - 1) % _MODULUS
        if 0 < missing < REMEMBERED:  # more, or back, is no counter that lost some
            self.gaps += missing

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        counted = (
            "sent", "expected", "unheard", "answered", "in_time", "late", "slow", "lost",
            "repeated", "unknown", "gaps", "restarts",
        )  # fmt: skip
        return {name: getattr(self, name) for name in counted}
