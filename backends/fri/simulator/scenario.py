"""A scenario: what goes wrong when, read from a YAML file and looked up once every cycle.

```yaml
seed: 7                                    # of what is lost, delayed, reordered and doubled
from: commanding                           # times count from the first COMMANDING_ACTIVE
events:
  - {event: loss, at: 2.0, for: 0.5, fraction: 0.1, direction: to_client}
  - {event: delay, at: 3.0, for: 1.0, delay: 0.002, jitter: 0.001}
  - {event: quality, at: 5.0, for: 0.2, quality: fair}
  - {event: safety_stop, at: 6.0, for: 0.5, state: stop2}
  - {event: session, at: 8.0, for: 0.3, state: monitoring_ready}
  - {event: push, at: 9.0, for: 0.5, joint: 2, torque: 10}
```
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import ClassVar, Final

from backends.fri.codec.messages import JOINTS, Quality, SafetyState, SessionState
from backends.fri.simulator.connection.port import UNDISTURBED, Disturbance
from limo_driver.runtime.declarations import read_yaml
from limo_driver.runtime.parameters import JOINT, Declared, parameter

_EPSILON: Final = 1e-9  # [s]


class Origin(Enum):
    """From when the times of a scenario count."""

    START = "start"  # of the controller
    COMMANDING = "commanding"  # the first COMMANDING_ACTIVE, however long the client took


@dataclass(frozen=True)
class ControllerScenario(Declared):
    """Events in order of time.

    Args:
        events: What happens.
        seed: Of what is lost, delayed, reordered and doubled.
        origin: From when their times count.
    """

    events: tuple[ControllerEvent, ...] = ()
    seed: int = parameter(default=0)
    origin: Origin = parameter(of=Origin, default=Origin.START, key="from")

    @classmethod
    def load(cls, path: Path) -> ControllerScenario:
        """Read a scenario file.

        Raises:
            ConfigError: Names the line, what was given and what exists.
        """
        given = read_yaml(path)
        events = [
            entry.make_one_of("event", EVENTS) for entry in given.optional("events").sections()
        ]
        return given.make(cls, {"events": tuple(events)})


@dataclass(frozen=True)
class Now:
    """State that a scenario asks for at one moment."""

    to_client: Disturbance = UNDISTURBED
    to_robot: Disturbance = UNDISTURBED
    quality: Quality = Quality.EXCELLENT  # at most
    safety: SafetyState = SafetyState.NORMAL
    session: SessionState = SessionState.COMMANDING_ACTIVE  # at most
    silent: bool = False
    pushes: tuple[SimulatedPush | FlangeForce, ...] = ()
    motions: tuple[ProgramMotion, ...] = ()
    guide: HandGuiding | None = None
    exchanges: tuple[Exchange, ...] = ()


class ScenarioClock:
    """Evaluates a scenario, cycle by cycle, at little cost between its events.

    Args:
        scenario: The events.
    """

    def __init__(self, scenario: ControllerScenario) -> None:
        self._coming = sorted(scenario.events, key=lambda event: event.at, reverse=True)
        self._active: list[ControllerEvent] = []
        self._next_change = 0.0  # [s]
        self._now = Now()
        self._origin = 0.0 if scenario.origin is Origin.START else math.inf  # [s]

    def begin_commanding(self, time: float) -> None:
        """Note that the client commands from a time on [s]; only the first one counts."""
        self._origin = min(self._origin, time)

    def since(self, time: float) -> float:
        """Return the time of the scenario [s]; before it began, minus infinity."""
        return time - self._origin

    def at(self, time: float) -> Now:
        """Return what holds at a time since the start [s]; times never go back."""
        time = self.since(time)
        if time < self._next_change - _EPSILON:
            return self._now
        while self._coming and self._coming[-1].at <= time + _EPSILON:
            self._active.append(self._coming.pop())
        self._active = [event for event in self._active if event.until > time + _EPSILON]
        ahead = [event.until for event in self._active]
        if self._coming:
            ahead.append(self._coming[-1].at)
        self._next_change = min(ahead, default=float("inf"))
        self._now = together(self._active)
        return self._now


def together(events: Iterable[ControllerEvent]) -> Now:
    """Return what events ask for at once: of two of a kind, the worse."""
    now = Now()
    for event in events:
        match event:
            case Loss() | Delay() | Reorder() | Duplicate():
                now = _disturbed(now, event)
            case QualityDrop():
                now = replace(now, quality=min(now.quality, event.quality))
            case SafetyStop():
                stops = {now.safety, event.state} - {SafetyState.NORMAL}
                now = replace(now, safety=min(stops, default=SafetyState.NORMAL))  # 1 is worst
            case SessionCap():
                now = replace(now, session=min(now.session, event.state))
            case Silence():
                now = replace(now, silent=True)
            case SimulatedPush() | FlangeForce():
                now = replace(now, pushes=(*now.pushes, event))
            case ProgramMotion():
                now = replace(now, motions=(*now.motions, event))
            case HandGuiding():
                now = replace(now, guide=event)
            case Exchange():
                now = replace(now, exchanges=(*now.exchanges, event))
            case _:
                raise TypeError(f"the controller has no form for {type(event).__name__}")
    return now


def _disturbed(now: Now, event: Loss | Delay | Reorder | Duplicate) -> Now:
    for name in ("to_client", "to_robot"):
        if event.direction in {Direction.BOTH, Direction(name)}:
            now = replace(now, **{name: _worse(getattr(now, name), event)})
    return now


def _worse(before: Disturbance, event: Loss | Delay | Reorder | Duplicate) -> Disturbance:
    match event:
        case Loss():
            return replace(before, loss=max(before.loss, event.fraction))
        case Reorder():
            return replace(before, reorder=max(before.reorder, event.fraction))
        case Duplicate():
            return replace(before, duplicate=max(before.duplicate, event.fraction))
        case Delay():
            return replace(
                before,
                delay=max(before.delay, event.delay),
                jitter=max(before.jitter, event.jitter),
            )


class Direction(Enum):
    """Direction of the datagrams that are disturbed."""

    BOTH = "both"
    TO_CLIENT = "to_client"
    TO_ROBOT = "to_robot"


@dataclass(frozen=True, kw_only=True)
class ControllerEvent(Declared):
    """Something that begins at a time and lasts for another."""

    name: ClassVar[str]
    at: float = parameter("s", lower=0.0, upper=1e9)  # since the start
    duration: float = parameter("s", lower=1e-3, upper=1e9, key="for")

    @property
    def until(self) -> float:
        """When it is over [s]."""
        return self.at + self.duration


@dataclass(frozen=True, kw_only=True)
class Loss(ControllerEvent):
    """Datagrams are lost."""

    name: ClassVar[str] = "loss"
    fraction: float = parameter("", lower=0.0, upper=1.0)
    direction: Direction = parameter(of=Direction, default=Direction.BOTH)


@dataclass(frozen=True, kw_only=True)
class Delay(ControllerEvent):
    """Datagrams come later, by a constant and an evenly distributed part."""

    name: ClassVar[str] = "delay"
    delay: float = parameter("s", lower=0.0, upper=10.0)
    jitter: float = parameter("s", lower=0.0, upper=10.0, default=0.0)
    direction: Direction = parameter(of=Direction, default=Direction.BOTH)


@dataclass(frozen=True, kw_only=True)
class Reorder(ControllerEvent):
    """Datagrams are overtaken by the next one."""

    name: ClassVar[str] = "reorder"
    fraction: float = parameter("", lower=0.0, upper=1.0)
    direction: Direction = parameter(of=Direction, default=Direction.BOTH)


@dataclass(frozen=True, kw_only=True)
class Duplicate(ControllerEvent):
    """Datagrams come twice."""

    name: ClassVar[str] = "duplicate"
    fraction: float = parameter("", lower=0.0, upper=1.0)
    direction: Direction = parameter(of=Direction, default=Direction.BOTH)


@dataclass(frozen=True, kw_only=True)
class QualityDrop(ControllerEvent):
    """The quality is at most this, whatever the client does."""

    name: ClassVar[str] = "quality"
    quality: Quality = parameter(of=Quality)


@dataclass(frozen=True, kw_only=True)
class SafetyStop(ControllerEvent):
    """The safety controller stops the arm."""

    name: ClassVar[str] = "safety_stop"
    state: SafetyState = parameter(of=SafetyState, default=SafetyState.STOP0_OR_1)


@dataclass(frozen=True, kw_only=True)
class SessionCap(ControllerEvent):
    """The session goes no higher than this state; `idle` closes it."""

    name: ClassVar[str] = "session"
    state: SessionState = parameter(of=SessionState)


@dataclass(frozen=True, kw_only=True)
class SimulatedPush(ControllerEvent):
    """Somebody leans on a joint."""

    name: ClassVar[str] = "push"
    joint: int = parameter(JOINT, upper=JOINTS)
    torque: float = parameter("N m", lower=-300.0, upper=300.0)


@dataclass(frozen=True, kw_only=True)
class FlangeForce(ControllerEvent):
    """Somebody pushes the flange, in the axes of the base."""

    name: ClassVar[str] = "force"
    force: tuple[float, ...] = parameter("N", lower=-300.0, upper=300.0, length=3)


@dataclass(frozen=True, kw_only=True)
class Silence(ControllerEvent):
    """The controller sends nothing, and goes on."""

    name: ClassVar[str] = "silence"


@dataclass(frozen=True, kw_only=True)
class ProgramMotion(ControllerEvent):
    """The robot's own program moves a joint there and back, smoothly: the ipo position."""

    name: ClassVar[str] = "motion"
    joint: int = parameter(JOINT, upper=JOINTS)
    amplitude: float = parameter("rad", lower=-3.0, upper=3.0)


@dataclass(frozen=True, kw_only=True)
class HandGuiding(ControllerEvent):
    """Somebody guides the arm by hand to a pose, while no client commands it; it stays there."""

    name: ClassVar[str] = "guide"
    position: tuple[float, ...] = parameter("rad", lower=-4.0, upper=4.0, length=JOINTS)


@dataclass(frozen=True, kw_only=True)
class Exchange(ControllerEvent):
    """What is measured of a joint is reported as of another, and the other way round."""

    name: ClassVar[str] = "exchange"
    joint: int = parameter(JOINT, upper=JOINTS)
    other: int = parameter(JOINT, upper=JOINTS)


EVENTS: dict[str, type[ControllerEvent]] = {
    kind.name: kind for kind in ControllerEvent.__subclasses__()
}
