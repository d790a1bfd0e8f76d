"""The two FRI messages as named tuples; the codec turns them into bytes and back.

The arm sends a `Monitoring` every send period, the client answers with a `Command`. Joint values
are tuples of seven floats; what a message leaves out is None. SI units, but the send period is in
milliseconds, as on the wire. Each field says where it stands on the wire, in order of its number.

Releases whose messages are the same form a generation; no known byte tells them apart:
| generation | versions         | told by                                                        |
|------------|------------------|----------------------------------------------------------------|
| ONE        | 1.11, 1.14-1.16  | bare protobuf, monitor data has field 3 (commanded position)   |
| TWO_FIVE   | 2.5              | bare protobuf, no field 3, but 9 or 10 (Cartesian pose)        |
| TWO_SEVEN  | 2.7              | u32 LE length - 8, protobuf, u32 LE CRC-32 of the protobuf     |
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Annotated, Final, NamedTuple, TypeAlias

from limo_driver.errors import ConfigError, WireFormatError

FRAME: Final = 8  # bytes around the protobuf of 2.7: length before it, CRC-32 after it
HEADER_TAG: Final = 0x0A  # field 1, length-delimited: every message begins with its header


class Generation(Enum):
    """Versions that share their messages; the value says so to a user."""

    ONE = "1.11 to 1.16"
    TWO_FIVE = "2.5"
    TWO_SEVEN = "2.7"

    def __init__(self, value: str) -> None:
        self.framed = value == "2.7"  # length and checksum stand around the protobuf

    @property
    def generation(self) -> Generation:
        """Itself, so that a version and a generation can be given alike."""
        return self

    @property
    def versions(self) -> tuple[FriVersion, ...]:
        """The versions of this generation."""
        return tuple(version for version in FriVersion if version.generation is self)


class FriVersion(Enum):
    """A release of FRI that limo speaks."""

    V1_11 = "1.11"
    V1_14 = "1.14"
    V1_15 = "1.15"
    V1_16 = "1.16"
    V2_5 = "2.5"
    V2_7 = "2.7"

    @classmethod
    def named(cls, name: str) -> FriVersion:
        """Return the version of a name such as `1.15`.

        Raises:
            ConfigError: No such version; names those that are known.
        """
        for version in cls:
            if version.value == name:
                return version
        known = ", ".join(version.value for version in cls)
        raise ConfigError(f"FRI version {name!r} is not known; known: {known}")

    @property
    def generation(self) -> Generation:
        """The versions with the same messages."""
        if self is FriVersion.V2_7:
            return Generation.TWO_SEVEN
        return Generation.TWO_FIVE if self is FriVersion.V2_5 else Generation.ONE


def framed(datagram: bytes) -> bool:
    """Say whether a datagram has the length of 2.7 in front and a header after it."""
    return (
        len(datagram) > FRAME
        and int.from_bytes(datagram[:4], "little") == len(datagram) - FRAME
        and datagram[4] == HEADER_TAG
    )


def frame(payload: bytes) -> bytes:
    """Put length and checksum around the protobuf of 2.7."""
    return b"%b%b%b" % (
        len(payload).to_bytes(4, "little"),
        payload,
        zlib.crc32(payload).to_bytes(4, "little"),
    )


def unframed(datagram: bytes) -> bytes:
    """Check the frame of 2.7 and return the protobuf in it.

    Raises:
        WireFormatError: Too short, another length, or a wrong checksum.
    """
    size = len(datagram)
    if size < FRAME:
        raise WireFormatError(f"frame of {size} bytes, expected at least {FRAME}")
    length = int.from_bytes(datagram[:4], "little")
    if length != size - FRAME:
        raise WireFormatError(f"frame says {length} bytes, but {size - FRAME} came")
    payload, given = datagram[4:-4], int.from_bytes(datagram[-4:], "little")
    if given != (computed := zlib.crc32(payload)):
        raise WireFormatError(f"checksum {given:08x}, computed {computed:08x}")
    return payload


JOINTS: Final = 7
MAX_DATAGRAM: Final = 1500  # bytes, each way
MAX_IO: Final = 10  # values in one message
MAX_TRANSFORMATIONS: Final = 5
MAX_NAME: Final = 63  # bytes of an IO's or a transformation's name
DEFAULT_PORT: Final = 30200
PORTS: Final = range(30200, 30210)  # several arms take consecutive ports
MONITORING_ID, COMMAND_ID = 0x245142, 0x34001
WRENCH: Final = 6  # [Fx Fy Fz τA τB τC]

ALL: Final = frozenset(Generation)
ONE: Final = frozenset({Generation.ONE})
FRAMED: Final = frozenset({Generation.TWO_SEVEN})
LATER, BARE = ALL - ONE, ALL - FRAMED
UINT32: Final = (0, (1 << 32) - 1)
UINT64: Final = (0, (1 << 64) - 1)
INT32: Final = (-(1 << 31), (1 << 31) - 1)

Numbers: TypeAlias = tuple[float, ...]
Joints: TypeAlias = Numbers  # seven values


@dataclass(frozen=True)
class Wire:
    """Field of a message on the wire; one without a default is required."""

    number: int
    span: tuple[int, int] = UINT32  # of an integer
    most: int | None = None  # values of a repeated field
    fewest: int = 0
    wrapped: bool = False  # in a message of their own, as its field 1
    packed: bool = False  # behind one tag
    only: frozenset[Generation] = ALL


def _joints(number: int, only: frozenset[Generation] = ALL) -> Wire:
    return Wire(number, most=JOINTS, fewest=JOINTS, wrapped=True, only=only)


def _vector(number: int, only: frozenset[Generation] = ALL) -> Wire:
    return Wire(number, most=WRENCH, wrapped=True, packed=True, only=only)


def _transformations(number: int) -> Wire:
    return Wire(number, most=MAX_TRANSFORMATIONS)


def _elements(count: int, only: frozenset[Generation]) -> Wire:
    return Wire(2, most=count, fewest=count, packed=True, only=only)


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


class Header(NamedTuple):
    """Counters of a message."""

    sequence: Annotated[int, Wire(2)]  # of the sender
    reflected: Annotated[int, Wire(3)]  # last sequence that the sender received


class Timestamp(NamedTuple):
    """Time of the robot, as Unix time."""

    seconds: Annotated[int, Wire(1)]
    nanoseconds: Annotated[int, Wire(2)]

    @property
    def nanoseconds_since_epoch(self) -> int:
        """The time as one integer [ns]."""
        return self.seconds * 1_000_000_000 + self.nanoseconds


class IoValue(NamedTuple):
    """An input or output and its value."""

    name: Annotated[str, Wire(1)]  # "Group.Name"
    type: Annotated[IoType, Wire(2)]
    direction: Annotated[IoDirection, Wire(3)]
    digital: Annotated[int | None, Wire(4, UINT64)] = None
    analog: Annotated[float | None, Wire(5)] = None

    @property
    def value(self) -> bool | int | float | None:
        """The value in its own type; None if the message left it out."""
        if self.type is IoType.ANALOG:
            return self.analog
        if self.type is IoType.BOOLEAN:
            return None if self.digital is None else self.digital != 0
        return self.digital


class Transformation(NamedTuple):
    """A named frame: twelve matrix elements in 1.x, [x y z qw qx qy qz] from 2.5 on."""

    name: Annotated[str, Wire(1)]
    elements: Annotated[Numbers, _elements(12, ONE), _elements(7, LATER)]
    timestamp: Annotated[Timestamp | None, Wire(3)] = None


class Redundancy(NamedTuple):
    """Redundancy resolution of a seven-axis arm (from 2.5 on)."""

    strategy: Annotated[RedundancyStrategy, Wire(1)]
    value: Annotated[float, Wire(2)]


class RobotInfo(NamedTuple):
    """State of the arm as a whole."""

    number_of_joints: Annotated[int | None, Wire(1, INT32)] = None
    safety_state: Annotated[SafetyState | None, Wire(2)] = None
    drive_states: Annotated[tuple[DriveState, ...], Wire(5, most=JOINTS)] = ()
    operation_mode: Annotated[OperationMode | None, Wire(6)] = None
    control_mode: Annotated[ControlMode | None, Wire(7)] = None


class MonitorData(NamedTuple):
    """Measurements of the arm."""

    measured_position: Annotated[Joints | None, _joints(1)] = None  # [rad]
    measured_torque: Annotated[Joints | None, _joints(2)] = None  # [N m]
    commanded_position: Annotated[Joints | None, _joints(3, ONE)] = None  # [rad]
    commanded_torque: Annotated[Joints | None, _joints(4)] = None  # [N m]
    external_torque: Annotated[Joints | None, _joints(5)] = None  # [N m], beyond the robot's model
    external_force: Annotated[Numbers | None, _vector(6, FRAMED)] = None  # (<= 6,) [N, N m]
    io: Annotated[tuple[IoValue, ...], Wire(8, most=MAX_IO)] = ()
    measured_pose: Annotated[Transformation | None, Wire(9, only=LATER)] = None
    measured_redundancy: Annotated[Redundancy | None, Wire(10, only=LATER)] = None
    timestamp: Annotated[Timestamp | None, Wire(15)] = None


class ConnectionInfo(NamedTuple):
    """State of the session and its connection."""

    session_state: Annotated[SessionState, Wire(1)]
    quality: Annotated[Quality, Wire(2)]
    send_period: Annotated[int | None, Wire(3)] = None  # [ms]
    receive_multiplier: Annotated[int | None, Wire(4)] = None  # packets to an answer


class IpoData(NamedTuple):
    """Command of the robot's own application at this moment."""

    joint_position: Annotated[Joints | None, _joints(1)] = None  # [rad]
    pose: Annotated[Transformation | None, Wire(2, only=LATER)] = None
    redundancy: Annotated[Redundancy | None, Wire(3, only=LATER)] = None
    command_mode: Annotated[CommandMode | None, Wire(10)] = None
    overlay_type: Annotated[OverlayType | None, Wire(11)] = None
    tracking_performance: Annotated[float | None, Wire(12)] = None  # 0 to 1


class Checksum(NamedTuple):
    """Checksum of a message."""

    crc32: Annotated[int | None, Wire(1, INT32)] = None


class EndOfMessage(NamedTuple):
    """Optional end of a message (up to 2.5)."""

    message_length: Annotated[int | None, Wire(1, INT32)] = None
    checksum: Annotated[Checksum | None, Wire(2)] = None


class Monitoring(NamedTuple):
    """Message that the arm sends in every send period."""

    header: Annotated[Header, Wire(1)]
    robot: Annotated[RobotInfo | None, Wire(2)] = None
    data: Annotated[MonitorData | None, Wire(3)] = None
    connection: Annotated[ConnectionInfo | None, Wire(4)] = None
    ipo: Annotated[IpoData | None, Wire(5)] = None
    requested_transformations: Annotated[tuple[Transformation, ...], _transformations(6)] = ()
    end: Annotated[EndOfMessage | None, Wire(15, only=BARE)] = None


class CommandData(NamedTuple):
    """Set-points of the client."""

    joint_position: Annotated[Joints | None, _joints(1)] = None  # [rad]
    wrench: Annotated[Numbers | None, _vector(2)] = None  # (6,) [Fx Fy Fz τA τB τC], [N, N m]
    joint_torque: Annotated[Joints | None, _joints(3)] = None  # [N m], added to impedance control
    transformations: Annotated[tuple[Transformation, ...], _transformations(4)] = ()
    io: Annotated[tuple[IoValue, ...], Wire(5, most=MAX_IO)] = ()
    pose: Annotated[Transformation | None, Wire(6, only=LATER)] = None
    redundancy: Annotated[Redundancy | None, Wire(7, only=LATER)] = None


class Command(NamedTuple):
    """Message that the client answers with."""

    header: Annotated[Header, Wire(1)]
    data: Annotated[CommandData | None, Wire(2)] = None
    end: Annotated[EndOfMessage | None, Wire(15, only=BARE)] = None
