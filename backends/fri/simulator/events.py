"""What can happen in a scenario: one class an event, with its parameters, units and bounds."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Any, ClassVar

from backends.fri.codec.messages import Quality, SafetyState, SessionState


class Direction(Enum):
    """Which datagrams a disturbance concerns."""

    BOTH = "both"
    TO_CLIENT = "to_client"
    TO_ROBOT = "to_robot"


def number(unit: str, lowest: float, highest: float, default: float | None = None) -> Any:  # noqa: ANN401  # a dataclass field
    """Return a field for a number within bounds, required unless it has a default."""
    known = {"unit": unit, "bounds": (lowest, highest)}
    return field(metadata=known) if default is None else field(default=default, metadata=known)


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something that begins at a time and lasts for another."""

    name: ClassVar[str]
    at: float = number("s", 0.0, 1e9)  # since the start
    duration: float = number("s", 1e-3, 1e9)  # `for` in the file

    @property
    def until(self) -> float:
        """When it is over [s]."""
        return self.at + self.duration


@dataclass(frozen=True, kw_only=True)
class Loss(Event):
    """Datagrams are lost."""

    name: ClassVar[str] = "loss"
    fraction: float = number("", 0.0, 1.0)
    direction: Direction = Direction.BOTH


@dataclass(frozen=True, kw_only=True)
class Delay(Event):
    """Datagrams come later, by a constant and an evenly distributed part."""

    name: ClassVar[str] = "delay"
    delay: float = number("s", 0.0, 10.0)
    jitter: float = number("s", 0.0, 10.0, 0.0)
    direction: Direction = Direction.BOTH


@dataclass(frozen=True, kw_only=True)
class Reorder(Event):
    """Datagrams are overtaken by the next one."""

    name: ClassVar[str] = "reorder"
    fraction: float = number("", 0.0, 1.0)
    direction: Direction = Direction.BOTH


@dataclass(frozen=True, kw_only=True)
class Duplicate(Event):
    """Datagrams come twice."""

    name: ClassVar[str] = "duplicate"
    fraction: float = number("", 0.0, 1.0)
    direction: Direction = Direction.BOTH


@dataclass(frozen=True, kw_only=True)
class QualityDrop(Event):
    """The quality is at most this, whatever the client does."""

    name: ClassVar[str] = "quality"
    quality: Quality


@dataclass(frozen=True, kw_only=True)
class SafetyStop(Event):
    """The safety controller stops the arm."""

    name: ClassVar[str] = "safety_stop"
    state: SafetyState = SafetyState.STOP0_OR_1


@dataclass(frozen=True, kw_only=True)
class SessionCap(Event):
    """The session goes no higher than this state; `idle` closes it."""

    name: ClassVar[str] = "session"
    state: SessionState


@dataclass(frozen=True, kw_only=True)
class Push(Event):
    """Somebody leans on a joint."""

    name: ClassVar[str] = "push"
    joint: int
    torque: float = number("N m", -300.0, 300.0)


@dataclass(frozen=True, kw_only=True)
class Silence(Event):
    """The controller sends nothing, and goes on."""

    name: ClassVar[str] = "silence"


@dataclass(frozen=True, kw_only=True)
class ProgramMotion(Event):
    """The robot's own program moves a joint there and back, smoothly: the ipo position."""

    name: ClassVar[str] = "motion"
    joint: int
    amplitude: float = number("rad", -3.0, 3.0)


EVENTS: dict[str, type[Event]] = {
    kind.name: kind
    for kind in (
        Loss,
        Delay,
        Reorder,
        Duplicate,
        QualityDrop,
        SafetyStop,
        SessionCap,
        Push,
        Silence,
        ProgramMotion,
    )
}

ENUMS: dict[str, type[Enum]] = {
    "Direction": Direction,
    "Quality": Quality,
    "SafetyState": SafetyState,
    "SessionState": SessionState,
}


def keys(kind: type[Event]) -> tuple[str, ...]:
    """Return the keys that an entry of this event may have, in the words of the file."""
    return ("event", *("for" if f.name == "duration" else f.name for f in fields(kind)))
