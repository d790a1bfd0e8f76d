"""Link: how a convention of drives is spoken, cycle by cycle; the robot knows no frame."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointCommand


@dataclass(frozen=True)
class DriveState:
    """What is known of one drive; a value that never came is NaN, never zero."""

    node: int
    status: str  # in words, for example `operation enabled`
    enabled: bool  # it follows its set-points
    position: float  # of the joint [rad]
    velocity: float  # [rad/s], by the drive; between positions where it sends none
    torque: float  # at the joint [N m]
    temperature: float = math.nan  # [°C]
    mode: str = ""  # in words, for example `position`
    error: str = ""  # in words; empty if there is none
    silent: int = 0  # cycles since it last spoke

    @property
    def stale(self) -> bool:
        """Whether the values are not of this cycle."""
        return self.silent > 0


@dataclass(frozen=True)
class Sample:
    """What the drives measured in one cycle; each array has shape (n,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    torque: FloatArray  # [N m]


class Link(ABC):
    """All drives of an arm.

    A cycle: `send` puts the set-points on the bus, where they wait; `listen` hears what comes until
    the cycle is due; `measure` starts the cycle, makes the set-points count, and collects what the
    drives measured.
    """

    @property
    @abstractmethod
    def torque_resolution(self) -> FloatArray:
        """Smallest change that the measured torques show, (n,) [N m]."""

    @abstractmethod
    def connect(self) -> None:
        """Find every drive, check that it is the right one, and configure it; none moves.

        Raises:
            BackendError: Names the joint, its node, and what is wrong.
        """

    @abstractmethod
    def enable(self, *, reset: bool = False) -> None:
        """Let the drives hold the pose that they measure.

        Args:
            reset: Reset the faults of drives.

        Raises:
            BackendError: Names the drive that does not, and why.
        """

    @abstractmethod
    def check(self, command: JointCommand) -> None:
        """Refuse a command that the drives cannot carry out.

        Raises:
            BackendError: What they can.
        """

    @abstractmethod
    def command(self, command: JointCommand) -> None:
        """Take the set-points of the coming cycle."""

    @abstractmethod
    def begin(self) -> None:
        """Follow commands again that start from the measured pose."""

    @abstractmethod
    def send(self) -> None:
        """Put the set-points of this cycle on the bus, commanded or not."""

    @abstractmethod
    def listen(self, until: float) -> None:
        """Take in what the drives say until then [s], of the port's clock."""

    @abstractmethod
    def measure(self, until: float) -> Sample | None:
        """Start a cycle and return what all drives measured; None if one was not heard in time."""

    @abstractmethod
    def trouble(self) -> str:
        """Say why the arm has to hold; empty if it need not."""

    @abstractmethod
    def drives(self) -> tuple[DriveState, ...]:
        """Return what is known of every drive."""

    @abstractmethod
    def disable(self) -> None:
        """Switch the drives off, one after the other, the last joint first."""
