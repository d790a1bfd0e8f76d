"""Report of a run of the simulated controller, as text or as one JSON object."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.fri.codec.messages import Quality

if TYPE_CHECKING:
    from backends.fri.simulator.connection.port import Fates
    from backends.fri.simulator.judge import Signals, Wanted
    from backends.fri.simulator.ledger import Ledger
    from backends.fri.simulator.session import ControllerVisit
    from limo_driver.types import FloatArray

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

    version: str
    client: str
    bound: str
    mode: str
    period_ms: int
    multiplier: int
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
        found = self.findings
        return {
            "version": self.version,
            "client": self.client,
            "bound": self.bound,
            "mode": self.mode,
            "period_ms": self.period_ms,
            "multiplier": self.multiplier,
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
        ledger = self.ledger
        lines = [
            f"FRI {self.version} to {self.client} from {self.bound}, {self.mode}, every "
            f"{self.period_ms} ms, {self.duration:.2f} s",
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
