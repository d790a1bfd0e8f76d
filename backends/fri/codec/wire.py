"""The protobuf wire format, as strictly as FRI needs it.

Integers may be padded with empty groups of seven bits, as some encoders write them. Groups (wire
types 3 and 4) occur in no version and are refused.

Source: "Protocol Buffers: Encoding", protobuf.dev.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from collections.abc import Iterator

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
