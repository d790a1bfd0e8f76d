"""Drive: interface of a simulated drive to bus, arm and scenario, whatever its protocol."""

from __future__ import annotations

from abc import ABC, abstractmethod


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
