"""CDR, the bytes of ROS 2 messages, and the schemas that say what is in them.

CDR, the encoding of ROS 2 messages: four bytes of header, then fields aligned to their size.

Alignment is counted from the end of the header. Strings end in a NUL that their length counts; an
empty sequence is its length alone, without the padding that its first element would need.

Source: OMG, "DDS-XTypes 1.3", section 7.4 (plain CDR, version 1).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limo_driver.errors import ShapeError, WireFormatError
from limo_driver.types import BoolArray, FloatArray

LITTLE_ENDIAN = b"\x00\x01\x00\x00"
HEADER_SIZE = 4
_AFTER_STAMP = 12  # bytes
NANOSECONDS = 1_000_000_000  # in a second
_NUMBERS = {order + code: struct.Struct(order + code) for order in "<>" for code in "BiI"}
_MOST_PADDING = 3  # bytes after the last field; some senders fill up to a whole word
JOINT_STATE = "sensor_msgs/msg/JointState"
TORQUE_ESTIMATE = "limo_msgs/msg/TorqueEstimate"
WRENCH = "geometry_msgs/msg/WrenchStamped"
MATRIX = "std_msgs/msg/Float64MultiArray"
LOG = "rcl_interfaces/msg/Log"
ENCODING = "ros2msg"  # of the schemas, as MCAP calls it

_SEPARATOR = "=" * 80
_TIME = f"""{_SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_HEADER = f"""{_SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
"""

SCHEMAS = {
    JOINT_STATE: f"""std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
{_HEADER}{_TIME}""",
    TORQUE_ESTIMATE: f"""std_msgs/Header header
string[] name
float64[] torque
float64[] std
float64[] external
bool[] outside
string model
bool fallback
bool reset
uint8[3] since_gap
{_HEADER}{_TIME}""",
    LOG: f"""byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
{_TIME}""",
}


class CdrWriter:
    """Appends fields to a little-endian message, `data`.

    Raises:
        WireFormatError: From every method, where a value does not fit into its field.
    """

    def __init__(self) -> None:
        self.data = bytearray(LITTLE_ENDIAN)

    def number(self, code: str, value: int) -> None:
        """Append an integer of a type of the module `struct` (B, i, I), aligned to its size."""
        packer = _NUMBERS["<" + code]
        self.data += b"\x00" * padding(len(self.data), packer.size)
        try:
            self.data += packer.pack(value)
        except struct.error as error:
            raise WireFormatError(f"{value} does not fit: {error}", len(self.data)) from None

    def time(self, stamp_ns: int) -> None:
        """Append a time [ns] as seconds and nanoseconds."""
        self.data += struct.pack("<iI", *split_time(stamp_ns))

    def string(self, text: str) -> None:
        """Append a string, in UTF-8."""
        encoded = utf8(text)
        self.number("I", len(encoded) + 1)
        self.data += encoded + b"\x00"

    def strings(self, texts: Sequence[str]) -> None:
        """Append a sequence of strings."""
        self.number("I", len(texts))
        for text in texts:
            self.string(text)

    def doubles(self, values: FloatArray) -> None:
        """Append so many numbers, without their count."""
        self.data += b"\x00" * padding(len(self.data), 8)
        self.data += values.astype("<f8").tobytes()


class RobotCodec:
    """Common head of all messages about the joints of one robot, encoded once, and layouts.

    Args:
        names: Joints, in the order of the arrays.
        frame_id: Of the header.
        codes: Types of the arrays that follow, of the module `struct`.
    """

    def __init__(self, names: Sequence[str], frame_id: str, codes: str) -> None:
        self.names, self.frame_id = tuple(names), frame_id
        writer = CdrWriter()
        writer.time(0)
        writer.string(frame_id)
        writer.strings(self.names)
        self._fixed = bytes(writer.data[_AFTER_STAMP:])
        self.start = start = len(writer.data)  # of the arrays
        self._layouts = {  # by the lengths of the arrays, each of which may be empty
            lengths: struct.Struct(
                f"<4siI{len(self._fixed)}s" + sequences(start, zip(codes, lengths, strict=True))
            )
            for lengths in product({0, len(self.names)}, repeat=len(codes))
        }

    def _packed(self, stamp_ns: int, **arrays: NDArray[Any]) -> bytes:
        """Return a message of these arrays, each behind its length.

        Raises:
            ShapeError: An array has another shape than (n,) or (0,).
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        lengths = tuple([len(values) for values in arrays.values()])
        fields = [x for values in arrays.values() for x in (len(values), *values.tolist())]
        try:
            layout, time = self._layouts[lengths], split_time(stamp_ns)
            return layout.pack(LITTLE_ENDIAN, *time, self._fixed, *fields)
        except (KeyError, struct.error):
            check_shapes(len(self.names), **arrays)
            raise


class CdrReader:
    """Takes fields off a message, one after the other.

    Raises:
        WireFormatError: From the constructor and every method, where the bytes are no such field;
            nothing is allocated that the message is too short for.
    """

    def __init__(self, payload: bytes | memoryview) -> None:
        self._data = bytes(payload)
        self.offset = HEADER_SIZE  # of the next field
        if len(self._data) < HEADER_SIZE:
            raise WireFormatError(
                f"CDR message of {len(self._data)} bytes, expected a header of {HEADER_SIZE}", 0
            )
        if self._data[0] != 0 or self._data[1] > 1:
            raise WireFormatError(f"encoding {self._data[:2].hex(' ')}, expected 00 00 or 00 01", 0)
        self._order = "<" if self._data[1] else ">"

    def number(self, code: str, name: str) -> int:
        """Take an integer of a type of the module `struct`: B, i or I."""
        packer = _NUMBERS[self._order + code]
        return packer.unpack_from(self._data, self._take(packer.size, packer.size, name))[0]

    def flag(self, name: str) -> bool:
        """Take one byte that is 0 or 1."""
        return self._flags(1, name) == b"\x01"

    def time(self, name: str) -> int:
        """Take seconds and nanoseconds [ns]."""
        seconds = self.number("i", name)
        nanoseconds = self.number("I", name)
        if nanoseconds >= NANOSECONDS:
            raise WireFormatError(
                f"{name} has {nanoseconds} ns, expected less than a second", self.offset - 4
            )
        return seconds * NANOSECONDS + nanoseconds

    def string(self, name: str) -> str:
        """Take a string; some senders give an empty one no NUL."""
        length = self.number("I", name)
        if length == 0:
            return ""
        at = self._take(length, 1, name)
        end = at + length - 1
        if self._data[end]:
            raise WireFormatError(f"{name} does not end in a NUL", end)
        try:
            return self._data[at:end].decode()
        except UnicodeDecodeError as error:
            raise WireFormatError(f"{name} is no UTF-8", at + error.start) from None

    def strings(self, name: str) -> tuple[str, ...]:
        """Take a sequence of strings."""
        count = self._count(4, name)
        return tuple([self.string(name) for _ in range(count)])

    def doubles(self, name: str) -> FloatArray:
        """Take a sequence of numbers; read-only, (length,)."""
        count = self._count(8, name)
        at = self._take(8 * count, 8, name) if count else self.offset
        values = np.frombuffer(self._data, f"{self._order}f8", count, at).astype(np.float64)
        values.setflags(write=False)
        return values

    def flags(self, name: str) -> BoolArray:
        """Take a sequence of bytes that are 0 or 1; read-only, (length,)."""
        count = self._count(1, name)
        return np.frombuffer(self._flags(count, name), np.bool_)

    def later(self, size: int) -> bytes:
        """Take bytes that senders of before did not send; zeros of those."""
        if len(self._data) - self.offset < size:
            return bytes(size)
        self.offset += size
        return self._data[self.offset - size : self.offset]

    def end(self) -> None:
        """Check that the message ends here."""
        left = len(self._data) - self.offset
        if left > _MOST_PADDING:
            raise WireFormatError(f"{left} bytes after the last field", self.offset)

    def _count(self, size: int, name: str) -> int:
        """Take the length of a sequence whose elements have at least `size` bytes."""
        count = self.number("I", name)
        if (left := len(self._data) - self.offset) < count * size:
            raise WireFormatError(
                f"{name} has length {count}, but {left} bytes are left", self.offset - 4
            )
        return count

    def _take(self, size: int, alignment: int, name: str) -> int:
        at = self.offset + padding(self.offset, alignment)
        if at + size > len(self._data):
            raise WireFormatError(
                f"{name} needs {size} bytes, {max(len(self._data) - at, 0)} are left", at
            )
        self.offset = at + size
        return at

    def _flags(self, count: int, name: str) -> bytes:
        at = self._take(count, 1, name)
        values = self._data[at : at + count]
        for j, value in enumerate(values):
            if value > 1:
                raise WireFormatError(f"{name} has {value}, expected 0 or 1", at + j)
        return values


def utf8(text: str) -> bytes:
    """Return a text in UTF-8.

    Raises:
        WireFormatError: It has half a surrogate pair in it.
    """
    try:
        return text.encode()
    except UnicodeEncodeError as error:
        raise WireFormatError(f"{text!r} cannot be written in UTF-8", error.start) from None


def padding(offset: int, size: int) -> int:
    """Return how many bytes come before a field of `size` bytes that cannot start before here."""
    return (HEADER_SIZE - offset) % size


def sequences(offset: int, kinds: Iterable[tuple[str, int]]) -> str:
    """Return sequences of numbers as a format of the module `struct`, lengths and padding included.

    Args:
        offset: Where the first begins, in bytes from the start of the message.
        kinds: Type of the elements, as in `struct`, and length of each sequence.
    """
    text = ""
    for code, length in kinds:
        before = padding(offset, 4)
        offset += before + 4
        size = struct.calcsize(f"<{code}")
        between = padding(offset, size) if length else 0
        offset += between + size * length
        text += f"{before}xI{between}x{length}{code}"
    return text


def split_time(stamp_ns: int) -> tuple[int, int]:
    """Return seconds and nanoseconds.

    Raises:
        WireFormatError: The seconds do not fit into 32 bits.
    """
    seconds, nanoseconds = divmod(stamp_ns, NANOSECONDS)
    if not -(2**31) <= seconds < 2**31:
        raise WireFormatError(f"time of {stamp_ns} ns, expected seconds of 32 bits", HEADER_SIZE)
    return seconds, nanoseconds


def check_lengths(offset: int, **lengths: int) -> None:
    """Check that all sequences have one length, or none.

    Raises:
        WireFormatError: They do not; `offset` is where they end.
    """
    if len({length for length in lengths.values() if length}) > 1:
        given = ", ".join(f"{name} {length}" for name, length in lengths.items())
        raise WireFormatError(f"sequences of lengths {given}; expected one length, or 0", offset)


def check_shapes(n: int, **arrays: ArrayLike) -> None:
    """Check that each array to be encoded is of shape (n,) or (0,).

    Raises:
        ShapeError: One is not.
    """
    for name, values in arrays.items():
        if (shape := np.shape(values)) not in {(n,), (0,)}:
            raise ShapeError(name, shape, f"({n},) or (0,)")
