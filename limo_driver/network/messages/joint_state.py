"""Joint states on the wire, and the numbers of their source and time that go with them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple, Self

import numpy as np

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages.cdr import (
    HEADER_SIZE,
    LITTLE_ENDIAN,
    NANOSECONDS,
    CdrReader,
    RobotCodec,
    check_lengths,
    utf8,
)
from limo_driver.types import FloatArray

_DOUBLES: Final = np.dtype("<f8")
_LONGEST = 65536  # bytes, room for a thousand joints; a stranger's names are not read for seconds
VERSION = 1
GID_SIZE = 16
_HEAD = struct.Struct("<4siI")
_STAMP_END = _HEAD.size
_NATIVE = struct.Struct("<BBqq")
_ROS = struct.Struct(f"<qqB{GID_SIZE}s")
_STALE, _HOLDING = 1, 2
_INT64 = range(-(2**63), 2**63)


class JointStateMessage(NamedTuple):
    """A joint state as it came off the wire; arrays have one value for each name, or none."""

    stamp_ns: int  # of the source
    frame_id: str
    names: tuple[str, ...]
    position: FloatArray  # (n,) or (0,) [rad]
    velocity: FloatArray  # (n,) or (0,) [rad/s]
    torque: FloatArray  # (n,) or (0,) [N m]; `effort` in ROS


class JointStateCodec(RobotCodec):
    """Encodes joint states of one robot; what does not change is encoded once.

    Args:
        names: Joints, in the order of the arrays.
        frame_id: Of the header.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        super().__init__(names, frame_id, "ddd")
        n = len(self.names)
        usual = self._layouts[n, n, n].format
        self._usual = struct.Struct(usual.replace(f"{n}d", f"{8 * n}x"))  # all but the arrays
        self._arrays = -8 * (3 * n + 2)  # where they begin, with a length of 8 bytes between two

    def encode(
        self, stamp_ns: int, position: FloatArray, velocity: FloatArray, torque: FloatArray
    ) -> bytes:
        """Return the message.

        Args:
            stamp_ns: Time of the sample [ns].
            position: Joint positions, shape (n,), or (0,) where unknown [rad].
            velocity: Joint velocities, likewise [rad/s].
            torque: Joint torques, likewise [N m].

        Raises:
            ShapeError: An array has another shape.
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        return self._packed(stamp_ns, position=position, velocity=velocity, torque=torque)

    def decode(self, payload: bytes | memoryview) -> JointStateMessage:
        """Return what `decode_joint_state` does, faster if the message is laid out like our own.

        Raises:
            WireFormatError: The payload is malformed; names its offset.
        """
        payload = bytes(payload)
        if self.names and len(payload) == self._usual.size:
            header, seconds, nanoseconds, fixed, *lengths = self._usual.unpack(payload)
            n = len(self.names)
            ours = header == LITTLE_ENDIAN and fixed == self._fixed and nanoseconds < NANOSECONDS
            if ours and lengths == [n, n, n]:
                values = np.frombuffer(payload[self._arrays :], _DOUBLES)  # aligned, as a copy
                return JointStateMessage(
                    seconds * NANOSECONDS + nanoseconds,
                    self.frame_id,
                    self.names,
                    values[:n],
                    values[n + 1 : 2 * n + 1],
                    values[2 * n + 2 :],
                )
        return decode_joint_state(payload)


class LiveJointStateCodec(JointStateCodec):
    """A codec for states that are used one after the other: each may be read into the same arrays.

    Args:
        names: Joints, in the order of the arrays.
        frame_id: Of the header.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        super().__init__(names, frame_id)
        n, nothing = len(self.names), np.zeros(len(self.names))
        like = self.encode(0, nothing, nothing, nothing)
        first = len(like) + self._arrays
        # a header ahead, so that what is aligned behind the message's own is so in memory
        own = np.zeros(HEADER_SIZE + len(like), np.uint8)[HEADER_SIZE:]
        self._own, values = own.data, own[first:].view(_DOUBLES)
        values.setflags(write=False)
        self._values = values[:n], values[n + 1 : 2 * n + 1], values[2 * n + 2 :]
        lengths = (slice(first + at, first + at + 8) for at in (8 * n, 16 * n + 8))
        self._spans = slice(_STAMP_END, first), *lengths
        self._like = [like[span] for span in self._spans]  # names and lengths

    def decode(self, payload: bytes | memoryview) -> JointStateMessage:
        """Return what `decode_joint_state` does; the next call may write over its arrays.

        Raises:
            WireFormatError: The payload is malformed; names its offset.
        """
        payload = bytes(payload)
        if len(payload) == self._usual.size:
            header, seconds, nanoseconds = _HEAD.unpack_from(payload)
            same = [payload[span] for span in self._spans] == self._like
            if same and header == LITTLE_ENDIAN and nanoseconds < NANOSECONDS:
                self._own[:] = payload
                stamp = seconds * NANOSECONDS + nanoseconds
                return JointStateMessage(stamp, self.frame_id, self.names, *self._values)
        return decode_joint_state(payload)


def decode_joint_state(payload: bytes | memoryview) -> JointStateMessage:
    """Return the joint state that a payload holds, of either byte order.

    Raises:
        WireFormatError: The payload is malformed, or longer than that of any arm; names its offset.
    """
    if len(payload) > _LONGEST:
        raise WireFormatError(
            f"joint state of {len(payload)} bytes, expected at most {_LONGEST}", _LONGEST
        )
    reader = CdrReader(payload)
    message = JointStateMessage(
        reader.time("stamp"),
        reader.string("frame_id"),
        reader.strings("name"),
        reader.doubles("position"),
        reader.doubles("velocity"),
        reader.doubles("effort"),
    )
    reader.end()
    check_lengths(
        reader.offset,
        name=len(message.names),
        position=message.position.size,
        velocity=message.velocity.size,
        effort=message.torque.size,
    )
    return message


class Attachment(NamedTuple):
    """Attachment on limo's own keys.

    Little-endian: version 1 and flags, a byte each; sequence and time, 64 bits each; then the
    version of the model in UTF-8, to the end.
    """

    sequence: int  # counts samples; a gap is a lost one
    stamp_ns: int  # monotonic, of the robot [ns]
    model: str = ""  # version of the model that made the payload, if one did
    stale: bool = False  # no new measurement: the values are the last known ones
    holding: bool = False  # the arm holds its pose

    def encode(self) -> bytes:
        """Return the attachment.

        Raises:
            ConfigError: A number does not fit into 64 bits.
            WireFormatError: UTF-8 cannot hold the version of the model.
        """
        flags = _STALE * self.stale | _HOLDING * self.holding
        try:
            return _NATIVE.pack(VERSION, flags, self.sequence, self.stamp_ns) + utf8(self.model)
        except struct.error:
            raise _too_large(self.sequence, self.stamp_ns) from None

    @classmethod
    def decode(cls, data: bytes | memoryview) -> Self:
        """Return what an attachment holds.

        Raises:
            WireFormatError: It is malformed, or of another version.
        """
        data = bytes(data)
        if data and data[0] != VERSION:
            raise WireFormatError(f"attachment of version {data[0]}, expected {VERSION}", 0)
        if len(data) < _NATIVE.size:
            raise WireFormatError(
                f"attachment of {len(data)} bytes, expected at least {_NATIVE.size}", len(data)
            )
        _, flags, sequence, stamp_ns = _NATIVE.unpack_from(data)
        if flags & ~(_STALE | _HOLDING):
            raise WireFormatError(f"unknown flags {flags:#04x}", 1)
        try:
            model = data[_NATIVE.size :].decode()
        except UnicodeDecodeError as error:
            raise WireFormatError("model is no UTF-8", _NATIVE.size + error.start) from None
        return cls(sequence, stamp_ns, model, bool(flags & _STALE), bool(flags & _HOLDING))


def relabelled(attachment: bytes, model: str) -> bytes:
    """Return an attachment as it came, but with the version of a model.

    Raises:
        WireFormatError: UTF-8 cannot hold the version.
    """
    return attachment[: _NATIVE.size] + utf8(model)


@dataclass(frozen=True)
class RosAttachment:
    """Attachment of rmw_zenoh: sequence, time, length of the identity, and the identity."""

    sequence: int
    stamp_ns: int  # Unix time [ns]
    gid: bytes  # 16 bytes that are the publisher's alone

    def encode(self) -> bytes:
        """Return the 33 bytes.

        Raises:
            ConfigError: A number does not fit into 64 bits, or the identity has not 16 bytes.
        """
        if len(self.gid) != GID_SIZE:
            raise ConfigError(f"gid has {len(self.gid)} bytes, expected {GID_SIZE}")
        try:
            return _ROS.pack(self.sequence, self.stamp_ns, GID_SIZE, self.gid)
        except struct.error:
            raise _too_large(self.sequence, self.stamp_ns) from None

    @classmethod
    def decode(cls, data: bytes | memoryview) -> Self:
        """Return what an attachment holds.

        Raises:
            WireFormatError: It is malformed.
        """
        data = bytes(data)
        if len(data) != _ROS.size:
            raise WireFormatError(
                f"attachment of {len(data)} bytes, expected {_ROS.size}", min(len(data), _ROS.size)
            )
        sequence, stamp_ns, size, gid = _ROS.unpack(data)
        if size != GID_SIZE:
            raise WireFormatError(f"gid of {size} bytes, expected {GID_SIZE}", _ROS.size - 17)
        return cls(sequence, stamp_ns, gid)


def _too_large(sequence: int, stamp_ns: int) -> ConfigError:
    name = "stamp_ns" if sequence in _INT64 else "sequence"
    value = stamp_ns if sequence in _INT64 else sequence
    return ConfigError(f"{name} is {value}, expected a whole number of 64 bits")
