"""How each version of FRI writes: its numbers and limits, and protobuf fields on the wire.

Versions of FRI: which of them share their messages, and how the bytes tell them apart.

Releases whose messages are the same on the wire form a generation. 1.11 cannot be told from 1.14 to
1.16, nor these from each other, by any byte that is known here: detection names the generation, and
only who started the session knows more.

| generation | versions         | told by                                                        |
|------------|------------------|----------------------------------------------------------------|
| ONE        | 1.11, 1.14-1.16  | bare protobuf, monitor data has field 3 (commanded position)   |
| TWO_FIVE   | 2.5              | bare protobuf, no field 3, but 9 or 10 (Cartesian pose)        |
| TWO_SEVEN  | 2.7              | u32 LE length - 8, protobuf, u32 LE CRC-32 of the protobuf     |

The protobuf wire format, as strictly as FRI needs it.

Integers may be padded with empty groups of seven bits, as some encoders write them. Groups (wire
types 3 and 4) occur in no version and are refused.

Source: "Protocol Buffers: Encoding", protobuf.dev.
"""

from __future__ import annotations

import struct
import zlib
from enum import Enum
from typing import TYPE_CHECKING, Final, NamedTuple

from limo_driver.errors import ConfigError, WireFormatError

if TYPE_CHECKING:
    from collections.abc import Iterator

FRAME: Final = 8  # bytes around the protobuf of 2.7: length before it, CRC-32 after it
HEADER_TAG: Final = 0x0A  # field 1, length-delimited: every message begins with its header
_MONITOR_DATA: Final = 3
_COMMANDED_POSITION: Final = 3
_CARTESIAN: Final = frozenset({9, 10})
VARINT: Final = 0
FIXED64: Final = 1
LENGTH_DELIMITED: Final = 2
FIXED32: Final = 5
TYPE_NAMES: Final = {
    VARINT: "integer", FIXED64: "double", LENGTH_DELIMITED: "message or text", FIXED32: "float",
}  # fmt: skip
LONGEST_VARINT: Final = 10  # bytes
_HIGHEST_NUMBER: Final = (1 << 29) - 1
_DOUBLE: Final = struct.Struct("<d")


class Generation(Enum):
    """Versions that share their messages; the value says so to a user."""

    ONE = "1.11 to 1.16"
    TWO_FIVE = "2.5"
    TWO_SEVEN = "2.7"

    @property
    def generation(self) -> Generation:
        """Itself, so that a version and a generation can be given alike."""
        return self

    @property
    def framed(self) -> bool:
        """Whether length and checksum stand around the protobuf."""
        return self is Generation.TWO_SEVEN

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


def detect(datagram: bytes) -> Generation | None:
    """Tell the generation of a monitoring message from its bytes.

    Returns:
        The generation; None where a message is bare protobuf but has none of the fields by which
        1.x and 2.5 differ, so that the next one has to tell.

    Raises:
        WireFormatError: No FRI message of any version.
    """
    if framed(datagram):
        unframed(datagram)
        return Generation.TWO_SEVEN
    if datagram[:1] != bytes([HEADER_TAG]):
        raise WireFormatError("neither a bare nor a framed FRI message", 0)
    numbers: set[int] = set()
    for field in fields_of(datagram, 0, len(datagram)):
        if field.number == _MONITOR_DATA and field.type == LENGTH_DELIMITED:
            inside = fields_of(datagram, field.start, field.stop)
            numbers.update(part.number for part in inside)
    if _COMMANDED_POSITION in numbers:
        return Generation.ONE
    return Generation.TWO_FIVE if numbers & _CARTESIAN else None


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


def unframed(datagram: bytes) -> tuple[int, int]:
    """Check the frame of 2.7 and return where its protobuf starts and stops.

    Raises:
        WireFormatError: Too short, another length, or a wrong checksum.
    """
    size = len(datagram)
    if size < FRAME:
        raise WireFormatError(f"frame of {size} bytes, expected at least {FRAME}", 0)
    length = int.from_bytes(datagram[:4], "little")
    if length != size - FRAME:
        raise WireFormatError(f"frame says {length} bytes, but {size - FRAME} came", 0)
    given = int.from_bytes(datagram[-4:], "little")
    computed = zlib.crc32(memoryview(datagram)[4:-4])
    if given != computed:
        raise WireFormatError(f"checksum {given:08x}, computed {computed:08x}", size - 4)
    return 4, size - 4


class Field(NamedTuple):
    """Place of one field in a datagram; `value` is the integer of a varint, and 0 of any other."""

    number: int
    type: int
    at: int  # offset of its tag
    start: int  # offset of its value
    stop: int  # offset after its value
    value: int


def fields_of(data: bytes, start: int, stop: int) -> Iterator[Field]:
    """Take the fields of a message apart, one after the other.

    Raises:
        WireFormatError: The bytes between `start` and `stop` are no fields.
    """
    at = start
    while at < stop:
        tag, after = read_varint(data, at, stop)
        number, kind = tag >> 3, tag & 7
        if not 1 <= number <= _HIGHEST_NUMBER:
            raise WireFormatError(f"field number {number}", at)
        value = 0
        if kind == VARINT:
            begin = after
            value, end = read_varint(data, after, stop)
        elif kind == LENGTH_DELIMITED:
            length, begin = read_varint(data, after, stop)
            end = begin + length
        elif kind in {FIXED64, FIXED32}:
            begin, end = after, after + (8 if kind == FIXED64 else 4)
        else:
            raise WireFormatError(f"wire type {kind} of field {number}", at)
        if end > stop:
            raise WireFormatError(f"field {number} ends {end - stop} bytes after its message", at)
        yield Field(number, kind, at, begin, end, value)
        at = end


def read_varint(data: bytes, at: int, stop: int) -> tuple[int, int]:
    """Return an unsigned integer of up to 64 bits and the offset after it.

    Raises:
        WireFormatError: It does not end before `stop`, or has more than 64 bits.
    """
    value = 0
    for k in range(LONGEST_VARINT):
        if at + k >= stop:
            raise WireFormatError("integer does not end", at)
        byte = data[at + k]
        value |= (byte & 0x7F) << 7 * k
        if byte < 0x80:  # noqa: PLR2004  # the last group of seven bits
            if value >> 64:
                raise WireFormatError("integer of more than 64 bits", at)
            return value, at + k + 1
    raise WireFormatError(f"integer of more than {LONGEST_VARINT} bytes", at)


def read_double(data: bytes, at: int) -> float:
    """Return the double at an offset that is known to be within the data."""
    value: float = _DOUBLE.unpack_from(data, at)[0]
    return value


def varint(value: int) -> bytes:
    """Return an unsigned integer of up to 64 bits in as few bytes as it needs."""
    if value < 0x80:  # noqa: PLR2004  # one group of seven bits
        return bytes((value,))
    out = bytearray()
    while value >= 0x80:  # noqa: PLR2004
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def double(value: float) -> bytes:
    """Return a double in little-endian bytes."""
    return _DOUBLE.pack(value)


def tag(number: int, kind: int) -> bytes:
    """Return what stands before a value: field number and wire type."""
    return varint(number << 3 | kind)


def delimited(number: int, content: bytes) -> bytes:
    """Return a field of a length and that many bytes."""
    return tag(number, LENGTH_DELIMITED) + varint(len(content)) + content
