"""Count every datagram sent and received once: answered in time, late or lost.

One answer is expected in every receive interval from the first answer of a client on. It is in time
if it comes within a send period of the interval's last packet, by the kernel's stamp of its arrival
and the time at which that packet really left; late if it comes later; lost if it never comes. So
`expected` is always the sum of what came in time, late, and not at all.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any, Final

from limo_driver.robot.realtime import LatencyHistogram

REMEMBERED: Final = 4096  # packets that can still be answered
_MODULUS: Final = 1 << 32  # of the counters
_NANO: Final = 1e-9
_RUNNING: Final = -1  # in place of the end of an interval that goes on


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


class _Fate(IntEnum):
    """What became of a receive interval."""

    OPEN = 0  # not answered yet
    IN_TIME = 1
    LATE = 2


@dataclass
class Ledger:
    """Counts of one run.

    Args:
        multiplier: Packets in one receive interval.
        late_ns: Answers that took longer are counted as slow as well, None for none [ns].
        period_ns: Send period [ns].
    """

    multiplier: int
    late_ns: int | None = None
    period_ns: int = 0
    sent: int = 0
    expected: int = 0  # intervals from the first answer of a client on
    unheard: int = 0  # intervals before it
    in_time: int = 0
    late: int = 0
    slow: int = 0
    repeated: int = 0
    unknown: int = 0
    gaps: int = 0  # numbers missing in the client's own counter
    restarts: int = 0  # clients that began to count anew
    latency: LatencyHistogram = field(default_factory=LatencyHistogram)

    def __post_init__(self) -> None:
        self._sent_at = [0] * REMEMBERED
        self._open = bytearray(REMEMBERED)  # whether a packet is still to be answered
        self._states = bytearray(REMEMBERED)  # of the session, as a packet said it
        self._disturbed = bytearray(REMEMBERED)  # whether a packet came twice, late or overtaken
        self._interval_of = [0] * REMEMBERED
        self._ended = [_RUNNING] * REMEMBERED  # when an interval's last packet was sent [ns]
        self._fates = bytearray(REMEMBERED)  # of intervals
        self._interval = self._judged = 0  # the one that runs, and the first that is not over
        self._closed = 0  # intervals that were told to be over
        self._client_sequence: int | None = None
        self._heard_from: int | None = None  # interval of the first answer
        self._in_interval = 0

    @property
    def answered(self) -> int:
        """Intervals that were answered, in time or late."""
        return self.in_time + self.late

    @property
    def lost(self) -> int:
        """Intervals that were never answered."""
        return self.expected - self.answered

    @property
    def next_sequence(self) -> int:
        """Counter of the next packet."""
        return self.sent % _MODULUS

    def send(self, now_ns: int, *, expects_answer: bool, state: int = 0) -> None:
        """Take note of a packet.

        Args:
            now_ns: When it left [ns].
            expects_answer: Whether clients answer such packets.
            state: Of the session.
        """
        place = self.sent % REMEMBERED
        self._sent_at[place], self._open[place] = now_ns, expects_answer
        self._states[place], self._disturbed[place] = state, False
        self._interval_of[place] = self._interval
        self.sent += 1
        self._in_interval += expects_answer
        if self._in_interval == self.multiplier:
            self._ended[self._interval % REMEMBERED] = now_ns
            self._interval += 1
            self._in_interval = 0
            self._ended[self._interval % REMEMBERED] = _RUNNING
            self._fates[self._interval % REMEMBERED] = _Fate.OPEN

    def disturb(self) -> None:
        """Note that the network doubles, delays or turns round the last packet."""
        self._disturbed[(self.sent - 1) % REMEMBERED] = True

    def close_interval(self) -> bool:
        """Say whether a receive interval has ended since this was asked last."""
        closed, self._closed = self._interval > self._closed, self._interval
        return closed

    def judge(self, now_ns: int) -> list[bool]:
        """Return of each interval whose time is over whether it was answered in time.

        The time of an interval is a send period from its last packet on, whenever that was sent: a
        controller that wakes up late itself gives a client no less.

        Args:
            now_ns: Up to when all answers were received [ns].
        """
        outcomes: list[bool] = []
        while self._judged < self._interval:
            place = self._judged % REMEMBERED
            fate = self._fates[place]
            if fate == _Fate.OPEN and now_ns < self._ended[place] + self.period_ns:
                break
            outcomes.append(fate == _Fate.IN_TIME)
            if self._heard_from is None or self._judged < self._heard_from:
                self.unheard += 1
            else:
                self.expected += 1
                self.in_time += fate == _Fate.IN_TIME
                self.late += fate == _Fate.LATE
            self._judged += 1
        return outcomes

    def receive(self, sequence: int, reflected: int, at_ns: int) -> Arrival:
        """Take note of an answer.

        Args:
            sequence: The client's own counter.
            reflected: Which packet it answers.
            at_ns: When it came, on the clock of `send` [ns].
        """
        self._count_client(sequence)
        place = self._place(reflected)
        interval = self._interval if place is None else self._interval_of[place]
        if self._heard_from is None:
            self._heard_from = interval
        if place is None:
            self.unknown += 1
            return Arrival.UNKNOWN
        if not self._open[place]:
            self.repeated += 1
            return Arrival.REPEATED
        self._open[place] = False
        took = at_ns - self._sent_at[place]
        self.latency.add(took * _NANO)
        self.slow += self.late_ns is not None and took > self.late_ns
        return self._settle(interval, at_ns)

    def state_of(self, reflected: int) -> int | None:
        """Return what a packet said of the session's state; None if it was never sent."""
        place = self._place(reflected)
        return None if place is None else self._states[place]

    def disturbed(self, reflected: int) -> bool:
        """Say whether the network doubled, delayed or turned round a packet."""
        place = self._place(reflected)
        return place is not None and bool(self._disturbed[place])

    def _place(self, reflected: int) -> int | None:
        """Return the place of a packet; None if it was never sent, or long ago."""
        age = (self.next_sequence - 1 - reflected) % _MODULUS
        return None if age >= min(REMEMBERED, self.sent) else (self.sent - 1 - age) % REMEMBERED

    def _settle(self, interval: int, at_ns: int) -> Arrival:
        """Note the answer to an interval; of several, the first counts."""
        place = interval % REMEMBERED
        ended = self._ended[place]
        in_time = ended == _RUNNING or at_ns <= ended + self.period_ns
        if self._fates[place] == _Fate.OPEN:
            self._fates[place] = _Fate.IN_TIME if in_time else _Fate.LATE
            expected = self._heard_from is not None and self._heard_from <= interval
            self.late += expected and interval < self._judged  # it had been given up
        return Arrival.IN_TIME if in_time else Arrival.LATE

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
