"""Events of a scenario, one class for each kind, with parameters, units and bounds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import ClassVar

from backends.fri.codec.messages import JOINTS, Quality, SafetyState, SessionState
from limo_driver.runtime.parameters import JOINT, Declared, parameter


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
class Silence(ControllerEvent):
    """The controller sends nothing, and goes on."""

    name: ClassVar[str] = "silence"


@dataclass(frozen=True, kw_only=True)
class ProgramMotion(ControllerEvent):
    """The robot's own program moves a joint there and back, smoothly: the ipo position."""

    name: ClassVar[str] = "motion"
    joint: int = parameter(JOINT, upper=JOINTS)
    amplitude: float = parameter("rad", lower=-3.0, upper=3.0)


EVENTS: dict[str, type[ControllerEvent]] = {
    kind.name: kind
    for kind in (
        Loss,
        Delay,
        Reorder,
        Duplicate,
        QualityDrop,
        SafetyStop,
        SessionCap,
        SimulatedPush,
        Silence,
        ProgramMotion,
    )
}
