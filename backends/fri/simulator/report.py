"""Report of a run of the simulated controller; each datagram counted: in time, late or lost."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.fri.codec.messages import Quality
from limo_driver.robot.realtime import LatencyHistogram

if TYPE_CHECKING:
    from backends.fri.simulator.connection.port import Fates
    from backends.fri.simulator.judge import Signals, Wanted
    from backends.fri.simulator.session import ControllerSettings, ControllerVisit
    from limo_driver.types import FloatArray

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
        # Note the answer to an interval; of several, the first counts
        place = interval % REMEMBERED
        ended = self._ended[place]
        in_time = ended == _RUNNING or at_ns <= ended + self.period_ns
        if self._fates[place] == _Fate.OPEN:
            self._fates[place] = _Fate.IN_TIME if in_time else _Fate.LATE
            expected = self._heard_from <= interval
            self.late += expected and interval < self._judged  # it had been given up
        return Arrival.IN_TIME if in_time else Arrival.LATE

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


MOST_COMPLAINTS: Final = 50  # kinds that are told apart
_OTHERS: Final = "other complaints"
_SHOWN: Final = 12  # visits in the text
_UNITS: Final = {"position": "rad", "torque": "N m", "wrench": "N, N m"}


@dataclass
class Complaint:
    """Mistake of a client, how often it was made, and when first."""

    first: float  # [s] since the start
    count: int = 0
    by_scenario: int = 0  # of them, cases that the scenario's network may have caused


@dataclass
class ClientObservations:
    """Observations of the client during a run; their size does not grow with its length."""

    complaints: dict[str, Complaint] = field(default_factory=dict)
    qualities: Counter[Quality] = field(default_factory=Counter)  # packets sent at each
    quality_changes: int = 0
    malformed: int = 0  # datagrams that are no command
    strangers: int = 0  # datagrams from elsewhere
    stops: list[tuple[float, str]] = field(default_factory=list)
    ranges: dict[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    largest_step: float = 0.0  # share of what a joint may go from one command to the next
    _last_quality: Quality | None = None

    def complain(self, text: str, now: float, *, by_scenario: bool = False) -> None:
        """Note what is wrong, and whether the scenario's network may have caused it."""
        if text not in self.complaints and len(self.complaints) >= MOST_COMPLAINTS:
            text = _OTHERS
        complaint = self.complaints.setdefault(text, Complaint(now))
        complaint.count += 1
        complaint.by_scenario += by_scenario

    def stop(self, text: str, now: float, *, by_scenario: bool = False) -> None:
        """Note that the arm was stopped."""
        if len(self.stops) < MOST_COMPLAINTS:
            self.stops.append((now, text))
        self.complain(text, now, by_scenario=by_scenario)

    def rate(self, quality: Quality) -> None:
        """Note the quality of a packet."""
        self.qualities[quality] += 1
        self.quality_changes += self._last_quality not in {None, quality}
        self._last_quality = quality

    def step(self, share: float) -> None:
        """Note how far a command goes."""
        self.largest_step = max(self.largest_step, share)

    def command(self, wanted: Wanted) -> None:
        """Note what a command asks for."""
        for name, values in wanted._asdict().items():
            if values is None:
                continue
            lower, upper = self.ranges.get(name, (values, values))
            self.ranges[name] = np.minimum(lower, values), np.maximum(upper, values)


@dataclass(frozen=True)
class ControllerReport:
    """Result of a run."""

    settings: ControllerSettings
    client: str
    bound: str
    duration: float  # [s]
    ledger: Ledger
    visits: tuple[ControllerVisit, ...]
    quality: Quality  # at the end of the session
    findings: ClientObservations
    signals: Signals
    fates: dict[str, Fates]  # of datagrams in each direction
    loop: dict[str, Any]  # lateness of the controller's own loop
    loop_text: str
    notes: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        found, settings = self.findings, self.settings
        return {
            "version": settings.version.value,
            "client": self.client,
            "bound": self.bound,
            "mode": settings.mode.name.lower(),
            "period_ms": settings.period_ms,
            "multiplier": settings.multiplier,
            "duration": self.duration,
            "packets": self.ledger.as_json()
            | {"malformed": found.malformed, "strangers": found.strangers},
            "answer_latency": self.ledger.latency.as_json(),
            "states": [
                {"state": visit.state.name, "at": round(visit.at, 6), "reason": visit.reason}
                for visit in self.visits
            ],
            "quality": {
                "last": self.quality.name,
                "changes": found.quality_changes,
                "packets": {level.name: found.qualities[level] for level in Quality},
            },
            "commands": {
                name: {"lower": lower.tolist(), "upper": upper.tolist()}
                for name, (lower, upper) in found.ranges.items()
            },
            "largest_step": found.largest_step,
            "stops": [{"at": at, "reason": text} for at, text in found.stops],
            "complaints": [
                {
                    "what": text,
                    "count": one.count,
                    "by_scenario": one.by_scenario,
                    "first": one.first,
                }
                for text, one in found.complaints.items()
            ],
            **self.signals.as_json(),
            "scenario": {name: vars(fates) for name, fates in self.fates.items()},
            "loop_lateness": self.loop,
            "notes": list(self.notes),
        }

    def as_text(self) -> str:
        """Return lines for people."""
        ledger, settings = self.ledger, self.settings
        lines = [
            f"FRI {settings.version.value} to {self.client} from {self.bound}, "
            f"{settings.mode.name.lower()}, every {settings.period_ms} ms, {self.duration:.2f} s",
            f"packets   {ledger.sent} sent; of {ledger.expected} answers expected "
            f"{ledger.answered} came, {ledger.late} late, {ledger.lost} lost",
            f"answers   {ledger.latency.summary()}"
            + ("" if ledger.late_ns is None else f"; {ledger.slow} slower than "
               f"{1e-6 * ledger.late_ns:g} ms"),
            "states    " + self._states(),
            f"quality   {self.quality.name} at the end, {self.findings.quality_changes} changes",
            *self._ranges(),
            f"steps     at most {100 * self.findings.largest_step:.1f} % of what a joint may go",
            f"own loop  {self.loop_text}",
        ]  # fmt: skip
        if ledger.unheard and not ledger.answered:
            lines.append("nobody answered: is a client bound to the port that --client names?")
        lines += [
            f"in {one.count} cases{_excused(one)}, first after {one.first:.3f} s: {text}"
            for text, one in self.findings.complaints.items()
        ]
        return "\n".join([*lines, *self.notes])

    def _states(self) -> str:
        shown = [f"{visit.state.name} {visit.at:.3f}" for visit in self.visits[:_SHOWN]]
        more = len(self.visits) - _SHOWN
        return ", ".join(shown) + (f", and {more} more" if more > 0 else "")

    def _ranges(self) -> list[str]:
        return [
            f"{name:9} "
            + ", ".join(f"{a:.3f}..{b:.3f}" for a, b in zip(lower, upper, strict=True))
            + f" {_UNITS[name]}"
            for name, (lower, upper) in self.findings.ranges.items()
        ]


def _excused(complaint: Complaint) -> str:
    if not complaint.by_scenario:
        return ""
    number = "all" if complaint.by_scenario == complaint.count else str(complaint.by_scenario)
    return f" ({number} of them where the scenario disturbed datagrams)"
