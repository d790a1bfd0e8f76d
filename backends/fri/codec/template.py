"""The hot path of decoding: a datagram like an earlier one is read by its numbers alone.

A layout is learned from a datagram that the codec read and would write as it is. Written twice with
other numbers in their places (doubles, counters, times), the message shows where these stand: where
the two differ. A datagram of that length whose other bytes are the same has its numbers there, too;
one comparison of large integers says so. Anything else goes through the codec. Results equal the
codec's to the bit; what has no such numbers is the very same object each time.

A few layouts are in use at a time, since counters and nanoseconds take one to five bytes each.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from operator import attrgetter, itemgetter
from typing import Any, Final, Generic, NamedTuple, TypeVar

from backends.fri.codec.codec import (
    MESSAGES,
    Version,
    datagram_of,
    decode,
    encode,
    payload_of,
    protobuf_of,
)
from backends.fri.codec.fields import MisfitError, Nested, Part
from backends.fri.codec.messages import Command, Monitoring, unframed

MOST_LAYOUTS: Final = 32  # that are remembered
MOST_WRITTEN: Final = 4  # messages
_CHANGING: Final = {"sequence", "reflected", "seconds", "nanoseconds"}  # integers
_HIGHEST: Final = (1 << 32) - 1
_FILLED: Final = {byte: struct.unpack("<d", bytes([byte] * 8))[0] for byte in (1, 2)}

Message = TypeVar("Message", Monitoring, Command)


class _Place(NamedTuple):
    """Where a value is found: among the numbers, the constants, or the results of earlier steps."""

    among: int
    start: int
    stop: int | None = None  # of several numbers


class _Learned:
    """The layout of one datagram.

    Args:
        payload: Its protobuf.
        message: What that says.
        filled: The same with other numbers, twice.
    """

    def __init__(self, payload: bytes, message: Any, filled: tuple[bytes, bytes]) -> None:
        self._codes: list[str] = []  # of the numbers: a double, or a counter of so many bytes
        self._constants: tuple[Any, ...] = ()
        steps: list[tuple[type, list[_Place]]] = []
        self._plan(message, "", steps)
        self._counters = [k for k, code in enumerate(self._codes) if code != "d"]
        ends = (0, len(self._codes), len(self._codes) + len(self._constants))
        self._steps = [(kind, _getter(places, ends)) for kind, places in steps]
        differs = bytes(one != other for one, other in zip(*filled, strict=True))
        mask, reading, at = bytearray(b"\xff" * len(payload)), "<", 0
        for code in self._codes:
            start, size = differs.index(1, at), struct.calcsize(code)
            reading += f"{start - at}x{code}"
            at = start + size
            # The top bits of a counter say how long it is.
            mask[start:at] = (b"\x00" if code == "d" else b"\x80") * size
        self._reading = struct.Struct(reading)
        self._mask = int.from_bytes(mask, "little")
        self._same = int.from_bytes(payload, "little") & self._mask

    def _plan(self, value: Any, name: str, steps: list[tuple[type, list[_Place]]]) -> _Place:
        """Note the numbers in a value, and how it is made of them; return where it is then."""
        first = len(self._codes)
        if _is_double(value):
            self._codes.append("d")
            return _Place(0, first)
        if name in _CHANGING:
            self._codes.append(f"{_size(value)}s")
            return _Place(0, first)
        if isinstance(value, tuple) and any(_numbers(value)):
            if all(map(_is_double, value)) and not hasattr(value, "_fields"):
                self._codes += ["d"] * len(value)
                return _Place(0, first, len(self._codes))
            places = [self._plan(item, part, steps) for part, item in _items(value)]
            steps.append((type(value), places))
            return _Place(2, len(steps) - 1)
        self._constants += (value,)
        return _Place(1, len(self._constants) - 1)

    def read(self, payload: bytes) -> Any:  # a message
        """Return the message of a datagram of this length; None if its layout is another."""
        if int.from_bytes(payload, "little") & self._mask != self._same:
            return None
        numbers: list[Any] = [*self._reading.unpack_from(payload)]
        for k in self._counters:
            value = 0
            for byte in reversed(numbers[k]):
                value = value << 7 | byte & 0x7F
            if value > _HIGHEST:
                return None
            numbers[k] = value
        values = (*numbers, *self._constants)
        for kind, get in self._steps:
            values += (tuple.__new__(kind, get(values)),)
        return values[-1]


class _Written:
    """A message that was written, into which others put their numbers where no more differs.

    Args:
        message: That was written.
        part: Of protobuf.
        fields: Of the message.
    """

    def __init__(self, message: Any, part: Any, fields: Sequence[Part]) -> None:
        self._part = part
        self._puts: list[Callable[[Any], None]] = []
        self._numbers: list[str] = []  # paths
        self._constants: list[str] = []
        self._sort(message, part, fields, "")
        self._take = attrgetter(*self._numbers, *self._constants)
        self._same = self._take(message)[len(self._numbers) :]

    def _sort(self, message: Any, part: Any, fields: Sequence[Part], before: str) -> None:
        """Note where numbers are put, and what has to stay."""
        for field, value in zip(fields, message, strict=True):
            path = before + field.name
            if isinstance(field, Nested) and value is not None:
                self._sort(value, getattr(part, field.name), field.of.parts, f"{path}.")
            elif value is None or not field.is_number:
                self._constants.append(path)
            else:
                self._numbers.append(path)
                self._puts.append(field.writer(part))

    def write(self, message: Any) -> Any:
        """Return protobuf's message of another one; None where more than numbers differs."""
        try:
            values = self._take(message)
            if values[len(self._numbers) :] != self._same:
                return None
            for put, value in zip(self._puts, values, strict=False):
                put(value)
        except (AttributeError, TypeError, ValueError, MisfitError):
            return None  # the codec says what is wrong
        return self._part


class Template(Generic[Message]):
    """Reads and writes one kind of message, fast where the layout is that of an earlier one."""

    def __init__(self, kind: type[Message], version: Version) -> None:
        self._kind, self._generation = kind, version.generation
        self._by_length: dict[int, _Learned] = {}
        self._fields = MESSAGES[self._generation][kind].parts
        self._written: list[_Written] = []

    def decode(self, data: bytes) -> Message:
        """Return the message of a datagram.

        Raises:
            WireFormatError: It is none.
        """
        learned = self._by_length.get(len(data))
        if learned is not None:
            payload = unframed(data) if self._generation.framed else data
            if (message := learned.read(payload)) is not None:
                return message
        message = decode(data, self._kind, self._generation)
        self._learn(data, message)
        return message

    def encode(self, message: Message) -> bytes:
        """Return the datagram of a message.

        Raises:
            WireFormatError: The version has no such value, or it does not fit.
        """
        for k, written in enumerate(self._written):
            if (part := written.write(message)) is not None:
                if k:
                    self._written.insert(0, self._written.pop(k))
                return datagram_of(part, self._generation)
        part = protobuf_of(message, self._generation)
        if not any(_has_lists(value) for value in message):
            self._written.insert(0, _Written(message, part, self._fields))
            del self._written[MOST_WRITTEN:]
        return datagram_of(part, self._generation)

    def _learn(self, data: bytes, message: Message) -> None:
        generation = self._generation
        if encode(message, generation) != data:
            return  # padded, packed, or with fields that are not known
        if len(self._by_length) >= MOST_LAYOUTS:
            self._by_length.clear()
        one, other = (
            payload_of(encode(_filled(message, "", byte), generation), generation)
            for byte in _FILLED
        )
        payload = payload_of(data, generation)
        self._by_length[len(data)] = _Learned(payload, message, (one, other))


class MonitoringTemplate(Template[Monitoring]):
    """Template of the robot's monitoring message."""

    def __init__(self, version: Version) -> None:
        super().__init__(Monitoring, version)


class CommandTemplate(Template[Command]):
    """Template of the client's command message."""

    def __init__(self, version: Version) -> None:
        super().__init__(Command, version)


def _has_lists(value: Any) -> bool:
    """Say whether there are messages in a list; their numbers stand at no path."""
    return isinstance(value, tuple) and any(
        isinstance(item, tuple) and (not hasattr(value, "_fields") or _has_lists(item))
        for item in value
    )


def _is_double(value: object) -> bool:
    return isinstance(value, float)


def _items(value: Any) -> Iterator[tuple[str, Any]]:  # a message, or several values
    """Yield what is in a tuple, each with its name if it has one."""
    return zip(getattr(value, "_fields", [""] * len(value)), value, strict=True)


def _numbers(value: Any) -> Iterator[bool]:
    """Yield for each part of a message whether it is a number that changes."""
    for name, item in _items(value):
        if isinstance(item, tuple):
            yield from _numbers(item)
        else:
            yield item is not None and (_is_double(item) or name in _CHANGING)


def _size(counter: int) -> int:
    """Return how many bytes an integer takes."""
    return max(-(-counter.bit_length() // 7), 1)


def _filled(value: Any, name: str, byte: int) -> Any:  # like the value
    """Return a value with other numbers that are as long, and have `byte` everywhere."""
    if isinstance(value, tuple):
        inside = [_filled(item, part, byte) for part, item in _items(value)]
        return tuple.__new__(type(value), inside)
    if _is_double(value):
        return _FILLED[byte]
    return sum(byte << 7 * k for k in range(_size(value))) if name in _CHANGING else value


def _getter(places: list[_Place], ends: tuple[int, int, int]) -> itemgetter[Any]:
    """Return what takes values from their places, as a tuple."""
    keys = [
        ends[among] + start if stop is None else slice(ends[among] + start, ends[among] + stop)
        for among, start, stop in places
    ]
    if len(keys) == 1:  # a getter of one key would return that value, not a tuple
        only = keys[0]
        keys = [slice(only, only + 1)] if isinstance(only, int) else keys
    return itemgetter(*keys)
