"""The two FRI messages as frozen values; the codec turns them into bytes and back.

The arm sends a `Monitoring` every send period and the client answers with a `Command`. Joint values
are tuples of exactly seven floats; what a message leaves out is None. SI units throughout, with the
send period as the wire has it, in milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final, TypeAlias

JOINTS: Final = 7
MAX_DATAGRAM: Final = 1500  # bytes, each way
MAX_IO: Final = 10  # values in one message
MAX_TRANSFORMATIONS: Final = 5
MAX_NAME: Final = 63  # bytes of an IO's or a transformation's name
DEFAULT_PORT: Final = 30200
PORTS: Final = range(30200, 30210)  # several arms take consecutive ports
MONITORING_ID: Final = 0x245142
COMMAND_ID: Final = 0x34001
WRENCH: Final = 6  # [Fx Fy Fz τA τB τC]

Joints: TypeAlias = tuple[float, ...]  # seven values


class SessionState(IntEnum):
    """State of a session; each is reached from the one before, and left to any lower one."""

    IDLE = 0
    MONITORING_WAIT = 1
    MONITORING_READY = 2
    COMMANDING_WAIT = 3
    COMMANDING_ACTIVE = 4


class Quality(IntEnum):
    """Quality of the connection as the controller judges it; GOOD is enough for commanding."""

    POOR = 0
    FAIR = 1
    GOOD = 2
    EXCELLENT = 3


class SafetyState(IntEnum):
    """Demand of the safety controller."""

    NORMAL = 0
    STOP0_OR_1 = 1
    STOP1_ON_PATH = 2
    STOP2 = 3


class OperationMode(IntEnum):
    """Key switch of the cell."""

    T1 = 0
    T2 = 1
    AUT = 2


class DriveState(IntEnum):
    """State of one drive."""

    OFF = 0
    TRANSITIONING = 1
    ACTIVE = 2


class ControlMode(IntEnum):
    """Mode in which the arm's own controller follows a position."""

    POSITION = 0
    CARTESIAN_IMPEDANCE = 1
    JOINT_IMPEDANCE = 2
    NONE = 3


class CommandMode(IntEnum):
    """Quantity that the robot's application lets the client command."""

    NONE = 0
    POSITION = 1
    WRENCH = 2
    TORQUE = 3
    CARTESIAN_POSE = 4  # from 2.5 on


class OverlayType(IntEnum):
    """Motion that the client's commands are superposed on."""

    NONE = 0
    JOINT = 1
    CARTESIAN = 2


class IoType(IntEnum):
    """Type of an input or output; a boolean travels in the digital value."""

    BOOLEAN = 0
    DIGITAL = 1
    ANALOG = 2


class IoDirection(IntEnum):
    """Direction of an input or output, seen from the robot."""

    INPUT = 0
    OUTPUT = 1


class RedundancyStrategy(IntEnum):
    """Meaning of the redundancy value of a seven-axis arm."""

    E1 = 0
    NONE = 4


@dataclass(frozen=True)
class Header:
    """Counters of a message."""

    sequence: int  # of the sender, uint32
    reflected: int  # last sequence that the sender received, uint32


@dataclass(frozen=True)
class Timestamp:
    """Time of the robot, as Unix time."""

    seconds: int
    nanoseconds: int

    @property
    def nanoseconds_since_epoch(self) -> int:
        """The time as one integer [ns]."""
        return self.seconds * 1_000_000_000 + self.nanoseconds


@dataclass(frozen=True)
class IoValue:
    """An input or output and its value."""

    name: str  # "Group.Name"
    type: IoType
    direction: IoDirection
    digital: int | None = None
    analog: float | None = None

    @property
    def value(self) -> bool | int | float | None:
        """The value in its own type; None if the message left it out."""
        if self.type is IoType.ANALOG:
            return self.analog
        if self.type is IoType.BOOLEAN:
            return None if self.digital is None else self.digital != 0
        return self.digital


@dataclass(frozen=True)
class Transformation:
    """A named frame: twelve matrix elements in 1.x, [x y z qw qx qy qz] from 2.5 on."""

    name: str
    elements: tuple[float, ...]
    timestamp: Timestamp | None = None


@dataclass(frozen=True)
class Redundancy:
    """Redundancy resolution of a seven-axis arm (from 2.5 on)."""

    strategy: RedundancyStrategy
    value: float


@dataclass(frozen=True)
class RobotInfo:
    """State of the arm as a whole."""

    number_of_joints: int | None = None
    safety_state: SafetyState | None = None
    drive_states: tuple[DriveState, ...] = ()
    operation_mode: OperationMode | None = None
    control_mode: ControlMode | None = None


@dataclass(frozen=True)
class MonitorData:
    """Measurements of the arm."""

    measured_position: Joints | None = None  # [rad]
    measured_torque: Joints | None = None  # [N m]
    commanded_position: Joints | None = None  # [rad], only 1.x
    commanded_torque: Joints | None = None  # [N m]
    external_torque: Joints | None = None  # [N m], measured minus the robot's own model
    external_force: tuple[float, ...] | None = None  # (<= 6,) [N, N m], only 2.7
    io: tuple[IoValue, ...] = ()
    measured_pose: Transformation | None = None  # from 2.5 on
    measured_redundancy: Redundancy | None = None  # from 2.5 on
    timestamp: Timestamp | None = None


@dataclass(frozen=True)
class ConnectionInfo:
    """State of the session and its connection."""

    session_state: SessionState
    quality: Quality
    send_period: int | None = None  # [ms]
    receive_multiplier: int | None = None  # the client answers every that many packets


@dataclass(frozen=True)
class IpoData:
    """Command of the robot's own application at this moment."""

    joint_position: Joints | None = None  # [rad]
    pose: Transformation | None = None  # from 2.5 on
    redundancy: Redundancy | None = None  # from 2.5 on
    command_mode: CommandMode | None = None
    overlay_type: OverlayType | None = None
    tracking_performance: float | None = None  # 0 to 1; 0 outside COMMANDING_ACTIVE


@dataclass(frozen=True)
class EndOfMessage:
    """Optional end of a message (up to 2.5)."""

    message_length: int | None = None
    crc32: int | None = None


@dataclass(frozen=True)
class Monitoring:
    """Message that the arm sends in every send period."""

    header: Header
    robot: RobotInfo | None = None
    data: MonitorData | None = None
    connection: ConnectionInfo | None = None
    ipo: IpoData | None = None
    requested_transformations: tuple[Transformation, ...] = ()
    end: EndOfMessage | None = None


@dataclass(frozen=True)
class CommandData:
    """Set-points of the client."""

    joint_position: Joints | None = None  # [rad]
    wrench: tuple[float, ...] | None = None  # (6,) [Fx Fy Fz τA τB τC], [N, N m]
    joint_torque: Joints | None = None  # [N m], added to joint impedance control
    transformations: tuple[Transformation, ...] = ()
    io: tuple[IoValue, ...] = ()
    pose: Transformation | None = None  # from 2.5 on
    redundancy: Redundancy | None = None  # from 2.5 on


@dataclass(frozen=True)
class Command:
    """Message that the client answers with."""

    header: Header
    data: CommandData | None = None
    end: EndOfMessage | None = None
