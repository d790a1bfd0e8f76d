"""Link: how a convention of drives is spoken, cycle by cycle; the robot knows no frame."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.can.config import ArmConfig
    from backends.can.port import BusPort, Frame
    from limo_driver.model import RobotModel
    from limo_driver.robot.output import Setpoint
    from limo_driver.types import FloatArray, JointCommand, RobotSpec

BACKLOG: Final = 256  # frames that are still read when no time is left
SHORTEST_WAIT: Final = 0.5  # of a period, for answers to a cycle that began late
OVERSLEPT: Final = 0.25  # of a period by which this program woke up late


@dataclass(frozen=True)
class DriveStatus:
    """Latest values of one drive; a value that never came is NaN, never zero."""

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


def status_line(status: str, error: str, silent: int) -> str:
    """Return the condition of a drive in words: status, error, cycles since it last spoke."""
    line = f"{status}: {error}" if error else status
    if silent:
        line = f"silent for {silent} cycle{'s' if silent > 1 else ''}, before: {line}"
    return line


@dataclass(frozen=True)
class DriveSample:
    """Measurements of the drives in one cycle; each array has shape (n,)."""

    position: FloatArray  # [rad]
    velocity: FloatArray  # [rad/s]
    torque: FloatArray  # [N m]


class Link(ABC):
    """All drives of an arm.

    A cycle: `send` puts the set-points on the bus, where they wait; `listen` hears what comes until
    the cycle is due; `measure` starts the cycle, makes the set-points count, and collects what the
    drives measured.

    Args:
        port: The bus.
        period: Of the cycles [s].
        model: The arm.
    """

    gains: tuple[FloatArray, FloatArray] | None = None  # by which positions are kept, if sent
    _handlers: dict[int, Callable[[bytes], None]]  # who takes the frames of each id
    carried: FloatArray | None = None  # gravity that was added last, (n,) [N m]; None for none

    def __init__(self, port: BusPort, period: float, model: RobotModel) -> None:
        self.port, self._period, self._model = port, period, model
        self.target = np.zeros(model.n)  # [rad]; not used before drives are enabled
        self.where: Callable[[], FloatArray | None] = lambda: None  # it is believed to be [rad]
        self._gravity_at: tuple[FloatArray | None, FloatArray] = None, self.target
        self._started = True
        self.intruder = ""  # who else commands the drives, as it was heard; empty if nobody does
        self.overslept = 0.0  # how late this program woke up for answers, in the last cycle [s]

    @property
    @abstractmethod
    def torque_resolution(self) -> FloatArray:
        """Smallest change that the measured torques show, (n,) [N m]."""

    @property
    @abstractmethod
    def most_torque(self) -> FloatArray:
        """Highest torque that can be said to the drives, (n,) [N m]."""

    def limit(self, config: ArmConfig) -> RobotSpec:
        """Return the arm's specification, with no more torque than can be said to its drives."""
        spec = config.spec(self.torque_resolution)
        torque = np.minimum(spec.limits.torque, self.most_torque)
        return replace(spec, limits=replace(spec.limits, torque=torque))

    def gravity(self) -> FloatArray:
        """Return the torque that carries the arm where it is believed to be, (n,) [N m]."""
        where, known = self.where(), self._gravity_at
        if where is None:  # nobody judges yet what drives measure
            return self._model.gravity_torque(self._position())[0]
        if where is not known[0]:
            known = self._gravity_at = where, self._model.gravity_torque(where)[0]
        return known[1]

    @abstractmethod
    def _position(self) -> FloatArray:
        """Return the positions measured last, (n,) [rad]."""

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
    def command(self, setpoint: Setpoint) -> None:
        """Take the set-points of the coming cycle."""

    @abstractmethod
    def begin(self) -> None:
        """Follow commands again that start from the measured pose."""

    @abstractmethod
    def send(self) -> None:
        """Put the set-points of this cycle on the bus, commanded or not."""

    def listen(self, until: float) -> None:
        """Take in what the drives say until then [s], of the port's clock."""
        self._hear(until, lambda: False)

    @abstractmethod
    def measure(self, until: float) -> DriveSample | None:
        """Start a cycle and return what all drives measured; None if one was not heard in time."""

    def observe(self, until: float) -> DriveSample | None:
        """Return what drives without power measure, as `measure` does; nothing is commanded."""
        return self.measure(until)

    def versions(self) -> tuple[dict[str, int], ...]:
        """Return what each drive says of its make, joint 1 first; nothing where they do not."""
        return ()

    @property
    def started(self) -> bool:
        """Whether the set-points of the cycle that was begun last have left."""
        return self._started

    def trouble(self) -> str:
        """Say why the arm has to hold; empty if it need not."""
        return self.trouble_of_bus() or self._trouble_of_drives()

    def trouble_of_bus(self) -> str:
        """Say what is wrong on the bus, whatever drives say; empty if nothing is."""
        if self.port.bus_off:
            return f"{self.port.name} is off: too many errors"
        if self.intruder:
            return f"another program commands the drives on {self.port.name}: {self.intruder}"
        return ""

    @abstractmethod
    def _trouble_of_drives(self) -> str:
        """Say which drive the arm has to hold for, and why; empty if for none."""

    @abstractmethod
    def drives(self) -> tuple[DriveStatus, ...]:
        """Return the latest values of every drive."""

    @abstractmethod
    def condition(self) -> tuple[FloatArray | None, tuple[str, ...]]:
        """Return temperatures (n,) [°C], None if there are none, and statuses, in every cycle."""

    @abstractmethod
    def disable(self) -> None:
        """Switch the drives off, one after the other, the last joint first."""

    def _intrude(self, what: str, frame_id: int) -> Callable[[bytes], None]:
        """Return what notes a frame that nobody but this program may send."""

        def note(_data: bytes) -> None:
            self.intruder = self.intruder or f"heard {what} (frame {frame_id:03X}); end it first"

        return note

    def _take(self, frame: Frame) -> None:
        """Note what a frame says; it may be of anybody."""
        if (handler := self._handlers.get(frame.id)) is not None:
            handler(frame.data)

    def _hear(self, until: float, enough: Callable[[], bool]) -> None:
        """Take in frames until then [s] or until it is enough; also what waits by then."""
        backlog = BACKLOG
        while not enough() and (frame := self.port.receive(until)) is not None:
            self._take(frame)
            if self.port.now() >= until:
                backlog -= 1
                if not backlog:  # a babbling node does not keep the arm from its cycles
                    return

    def _hear_answers(self, until: float, answered: Callable[[], bool], *, patient: bool) -> None:
        """Wait for what drives answer to a cycle that was started just now.

        A computer that stalls says nothing about drives: they have their time to answer from when
        the cycle was really started, and again once this program wakes up too late to have heard
        them in time.

        Args:
            until: When the next cycle is due [s].
            answered: Says whether all did.
            patient: Whether one more period may be waited: late is better than lost.
        """
        until = max(until, self.port.now() + SHORTEST_WAIT * self._period)
        if patient:
            until += self._period
        self._hear(until, answered)
        now = self.port.now()
        self.overslept = max(now - until, 0.0)
        if self.overslept > OVERSLEPT * self._period:
            self._hear(now + self._period, answered)
