"""What every simulated drive is, and the joint that it moves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum

AMBIENT = 25.0  # [°C]


class SimulatedDrive(ABC):
    """One drive on the bus, built into one joint."""

    node: int  # id under which it is spoken to

    @property
    @abstractmethod
    def period(self) -> float:
        """Configured communication period [s]; 0 if none."""

    @property
    @abstractmethod
    def enabled(self) -> bool:
        """Whether it follows set-points."""

    @abstractmethod
    def start(self, now: float) -> None:
        """Be switched on."""

    @abstractmethod
    def hear(self, frame_id: int, data: bytes, now: float) -> None:
        """Take a frame that may be for it; never a SYNC."""

    @abstractmethod
    def synchronise(self, now: float) -> None:
        """Hear a SYNC."""

    @abstractmethod
    def tick(self, now: float) -> None:
        """Let time pass, for heartbeats and watchdogs."""

    @abstractmethod
    def demand(self, period: float) -> None:
        """Tell the joint what to do in the coming period [s]."""

    @abstractmethod
    def fail(self, code: int) -> None:
        """Have a fault, with an error code of its convention."""

    @abstractmethod
    def recover(self) -> None:
        """Be back on the bus after it was off."""


class Actuation(Enum):
    """Way in which a drive acts on its joint."""

    BRAKE = "brake"  # closed without power: keeps the position at which it closed
    FREE = "free"  # no power and no brake: the arm falls
    POSITION = "position"  # the drive's servo follows `position`
    TORQUE = "torque"  # `torque` alone
    IMPEDANCE = "impedance"  # spring and damper around `position` and `velocity`, and `torque`


@dataclass
class JointPort:
    """The cable between one drive and its joint; SI units of the joint, signs of the arm.

    The drive writes what it makes the joint do, the arm writes what the sensors read.
    """

    position: float = 0.0  # to be reached at the end of the current communication period [rad]
    velocity: float = 0.0  # of an impedance [rad/s]
    torque: float = 0.0  # made as such, or beside the servo [N m]
    stiffness: float = 0.0  # [N m/rad]
    damping: float = 0.0  # [N m s/rad]
    actuation: Actuation = Actuation.BRAKE

    measured_position: float = 0.0  # [rad]
    measured_velocity: float = 0.0  # [rad/s]
    measured_torque: float = 0.0  # [N m]
    temperature: float = AMBIENT  # of the winding [°C]
