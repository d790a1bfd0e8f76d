"""Field layouts of the messages of each FRI generation, as data that the codec follows.

A `Layout` is one protobuf message: the value it becomes and its `Part`s in the order in which they
are written, which is that of their numbers. `fri.proto` says the same in protobuf's own language.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from backends.fri.codec import messages as m
from backends.fri.codec.version import Generation

if TYPE_CHECKING:
    from enum import IntEnum

CHANGING: Final = frozenset({"sequence", "reflected", "seconds", "nanoseconds"})  # integers
MATRIX: Final = 12
QUATERNION: Final = 7


class Kind(Enum):
    """Encoding of a value."""

    IDENTIFIER = "identifier of the message"
    UINT32 = "uint32"
    INT32 = "int32"
    UINT64 = "uint64"
    ENUM = "enum"
    DOUBLE = "double"
    DOUBLES = "packed doubles"
    TEXT = "text"
    MESSAGE = "message"
    JOINTS = "message of seven doubles, each with its tag"
    VECTOR = "message of packed doubles"


@dataclass(frozen=True)
class Part:
    """One field of a message."""

    number: int
    name: str  # attribute of the value
    kind: Kind
    of: Any = None  # Layout, enum, identifier, or how many doubles there have to be
    required: bool = False
    most: int | None = None  # of a repeated field; None if it comes once


@dataclass(frozen=True)
class Layout:
    """One protobuf message and the value that it becomes."""

    value: type
    parts: tuple[Part, ...]

    @cached_property
    def by_number(self) -> dict[int, Part]:
        """The parts by their field number."""
        return {part.number: part for part in self.parts}


@dataclass(frozen=True)
class Layouts:
    """The two messages of a generation."""

    monitoring: Layout
    command: Layout


def _header(identifier: int) -> Layout:
    return Layout(
        m.Header,
        (
            Part(1, "", Kind.IDENTIFIER, identifier, required=True),
            Part(2, "sequence", Kind.UINT32, required=True),
            Part(3, "reflected", Kind.UINT32, required=True),
        ),
    )


def _message(number: int, name: str, of: Layout, most: int | None = None) -> Part:
    return Part(number, name, Kind.MESSAGE, of, most=most)


def _joints(number: int, name: str) -> Part:
    return Part(number, name, Kind.JOINTS, m.JOINTS)


def _enum(number: int, name: str, of: type[IntEnum], *, required: bool = False) -> Part:
    return Part(number, name, Kind.ENUM, of, required)


_TIMESTAMP = Layout(
    m.Timestamp,
    (
        Part(1, "seconds", Kind.UINT32, required=True),
        Part(2, "nanoseconds", Kind.UINT32, required=True),
    ),
)
_IO = Layout(
    m.IoValue,
    (
        Part(1, "name", Kind.TEXT, required=True),
        _enum(2, "type", m.IoType, required=True),
        _enum(3, "direction", m.IoDirection, required=True),
        Part(4, "digital", Kind.UINT64),
        Part(5, "analog", Kind.DOUBLE),
    ),
)
_REDUNDANCY = Layout(
    m.Redundancy,
    (
        _enum(1, "strategy", m.RedundancyStrategy, required=True),
        Part(2, "value", Kind.DOUBLE, required=True),
    ),
)
_CONNECTION = Layout(
    m.ConnectionInfo,
    (
        _enum(1, "session_state", m.SessionState, required=True),
        _enum(2, "quality", m.Quality, required=True),
        Part(3, "send_period", Kind.UINT32),
        Part(4, "receive_multiplier", Kind.UINT32),
    ),
)
_ROBOT = Layout(
    m.RobotInfo,
    (
        Part(1, "number_of_joints", Kind.INT32),
        _enum(2, "safety_state", m.SafetyState),
        Part(5, "drive_states", Kind.ENUM, m.DriveState, most=m.JOINTS),
        _enum(6, "operation_mode", m.OperationMode),
        _enum(7, "control_mode", m.ControlMode),
    ),
)
_CHECKSUM = Part(1, "crc32", Kind.INT32)
_END = Layout(
    m.EndOfMessage,
    (
        Part(1, "message_length", Kind.INT32),
        # {1 crc32 int32 O}: a message of one number, which the value holds as that number
        Part(2, "crc32", Kind.MESSAGE, Layout(int, (_CHECKSUM,))),
    ),
)


def _transformation(elements: int) -> Layout:
    return Layout(
        m.Transformation,
        (
            Part(1, "name", Kind.TEXT, required=True),
            Part(2, "elements", Kind.DOUBLES, elements, required=True),
            _message(3, "timestamp", _TIMESTAMP),
        ),
    )


def _layouts(generation: Generation) -> Layouts:
    one, framed = generation is Generation.ONE, generation.framed
    frame = _transformation(MATRIX if one else QUATERNION)
    cartesian = () if one else (frame,)
    data = [_joints(1, "measured_position"), _joints(2, "measured_torque")]
    data += [_joints(3, "commanded_position")] if one else []
    data += [_joints(4, "commanded_torque"), _joints(5, "external_torque")]
    data += [Part(6, "external_force", Kind.VECTOR, m.WRENCH)] if framed else []
    data += [_message(8, "io", _IO, m.MAX_IO)]
    data += [_message(9, "measured_pose", pose) for pose in cartesian]
    data += [] if one else [_message(10, "measured_redundancy", _REDUNDANCY)]
    data += [_message(15, "timestamp", _TIMESTAMP)]
    ipo = [_joints(1, "joint_position")]
    ipo += [_message(2, "pose", pose) for pose in cartesian]
    ipo += [] if one else [_message(3, "redundancy", _REDUNDANCY)]
    ipo += [_enum(10, "command_mode", m.CommandMode), _enum(11, "overlay_type", m.OverlayType)]
    ipo += [Part(12, "tracking_performance", Kind.DOUBLE)]
    command = [_joints(1, "joint_position"), Part(2, "wrench", Kind.VECTOR, m.WRENCH)]
    command += [_joints(3, "joint_torque")]
    command += [_message(4, "transformations", frame, m.MAX_TRANSFORMATIONS)]
    command += [_message(5, "io", _IO, m.MAX_IO)]
    command += [_message(6, "pose", pose) for pose in cartesian]
    command += [] if one else [_message(7, "redundancy", _REDUNDANCY)]
    end = [] if framed else [_message(15, "end", _END)]
    monitoring = [
        Part(1, "header", Kind.MESSAGE, _header(m.MONITORING_ID), required=True),
        _message(2, "robot", _ROBOT),
        _message(3, "data", Layout(m.MonitorData, tuple(data))),
        _message(4, "connection", _CONNECTION),
        _message(5, "ipo", Layout(m.IpoData, tuple(ipo))),
        _message(6, "requested_transformations", frame, m.MAX_TRANSFORMATIONS),
        *end,
    ]
    answer = [
        Part(1, "header", Kind.MESSAGE, _header(m.COMMAND_ID), required=True),
        _message(2, "data", Layout(m.CommandData, tuple(command))),
        *end,
    ]
    return Layouts(Layout(m.Monitoring, tuple(monitoring)), Layout(m.Command, tuple(answer)))


LAYOUTS: Final = {generation: _layouts(generation) for generation in Generation}
