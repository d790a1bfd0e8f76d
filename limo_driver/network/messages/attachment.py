"""Attachments of network messages: sequence number, source time, and flags or identity."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages.cdr import utf8

if TYPE_CHECKING:
    from typing import Self

VERSION = 1
GID_SIZE = 16
_NATIVE = struct.Struct("<BBqq")
_ROS = struct.Struct(f"<qqB{GID_SIZE}s")
_STALE, _HOLDING = 1, 2
_INT64 = range(-(2**63), 2**63)


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
