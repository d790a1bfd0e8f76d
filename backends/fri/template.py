"""The hot path of both messages: only what changes from cycle to cycle is read and written.

A template is learned from one datagram that the strict codec read. It knows which bytes are values
(doubles, counters, times) and which have to stay as they are: tags, lengths, enums, texts. A
datagram of the same length whose other bytes are the same has the same layout, so its values stand
at known offsets; one comparison of large integers verifies that. Anything else goes through the
codec, from which the template then learns the new layout. Results equal the codec's to the bit.

A few layouts are in use at a time, since counters and nanoseconds take one to five bytes each.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from backends.fri.decoding import decode
from backends.fri.encoding import encode
from backends.fri.layouts import CHANGING, LAYOUTS, Layout
from backends.fri.messages import Command, Monitoring
from backends.fri.wire import varint

if TYPE_CHECKING:
    from backends.fri.codec import Version
    from backends.fri.decoding import Path, Trace
    from backends.fri.version import Generation

MOST_LAYOUTS: Final = 32  # that are remembered
_HIGHEST: Final = (1 << 32) - 1
_CRC: Final = 4  # bytes

Message = TypeVar("Message", Monitoring, Command)


@dataclass
class _Node:
    """How one message of a layout is put together from the values of a datagram."""

    like: Any  # the value that the layout was learned from
    arrays: list[tuple[str, int, int]] = field(default_factory=list)  # doubles: first, after last
    numbers: list[tuple[str, int]] = field(default_factory=list)  # one double each
    counters: list[tuple[str, int]] = field(default_factory=list)
    children: list[tuple[str, _Node]] = field(default_factory=list)
    lists: list[tuple[str, list[_Node]]] = field(default_factory=list)  # messages that repeat
    fixed: list[tuple[str, Any]] = field(default_factory=list)  # what must not change
    written: dict[str, bytes] = field(default_factory=dict[str, bytes])  # counters read last,
    counted: dict[str, int] = field(default_factory=dict[str, int])  # and what they say

    def build(self, values: tuple[Any, ...]) -> Any:  # noqa: ANN401  # the like of `like`
        """Return the value of a datagram, whose numbers are `values`."""
        made: Any = object.__new__(type(self.like))  # frozen: its constructor is ten times slower
        content: dict[str, Any] = made.__dict__
        content.update(self.like.__dict__)
        for name, start, stop in self.arrays:
            content[name] = values[start:stop]
        for name, at in self.numbers:
            content[name] = values[at]
        for name, at in self.counters:
            written = values[at]
            if written != self.written.get(name):  # seconds, for one, seldom change
                self.written[name], self.counted[name] = written, _counter(written)
            content[name] = self.counted[name]
        for name, child in self.children:
            content[name] = child.build(values)
        for name, items in self.lists:
            content[name] = tuple([item.build(values) for item in items])
        return made

    def take(self, message: Any, values: list[Any]) -> bool:  # noqa: ANN401
        """Write the numbers of a message into `values`; False if the layout is another."""
        content: dict[str, Any] = message.__dict__
        for name, like in self.fixed:
            if content[name] is not like and not _same(content[name], like):
                return False
        for name, start, stop in self.arrays:
            given = content[name]
            if given is None or len(given) != stop - start:
                return False
            values[start:stop] = given
        for name, at in self.numbers:
            if (number := content[name]) is None:
                return False
            values[at] = number
        for name, at in self.counters:
            written = varint(content[name]) if 0 <= content[name] <= _HIGHEST else b""
            if len(written) != len(values[at]):
                return False
            values[at] = written
        return self._take_inner(content, values)

    def _take_inner(self, content: dict[str, Any], values: list[Any]) -> bool:
        for name, child in self.children:
            part = content[name]
            if part is None or not child.take(part, values):
                return False
        for name, items in self.lists:
            parts = content[name]
            if len(parts) != len(items):
                return False
            if not all(map(_Node.take, items, parts, [values] * len(items))):
                return False
        return True


class _Learned:
    """The layout of one datagram."""

    def __init__(self, data: bytes, message: Any, trace: Trace, generation: Generation) -> None:  # noqa: ANN401
        self.framed = generation.framed
        trace = sorted(trace, key=lambda item: item[1])
        end = len(data) - (_CRC if self.framed else 0)
        mask, at = bytearray(b"\xff" * len(data)), 0
        mask[end:] = b"\x00" * (len(data) - end)
        reading, writing = "<", "<"
        self._pieces: list[Any] = []
        for path, start, stop in trace:
            counts = path[-1] in CHANGING
            # The top bits of a counter say how long it is.
            mask[start:stop] = (b"\x80" if counts else b"\x00") * (stop - start)
            code = f"{stop - start}s" if counts else "d"
            reading += f"{start - at}x{code}"
            writing += f"{start - at}s{code}"
            self._pieces += [data[at:start], data[start:stop] if counts else 0.0]
            at = stop
        self._pieces.append(data[at:end])
        self._reading = struct.Struct(reading)
        self._writing = struct.Struct(writing + f"{end - at}s")
        self._mask = int.from_bytes(mask, "little")
        self._same = int.from_bytes(data, "little") & self._mask
        self._root = _node(message, trace, ())

    def read(self, data: bytes) -> Any:  # noqa: ANN401
        """Return the message of a datagram of this length; None if its layout is another."""
        if int.from_bytes(data, "little") & self._mask != self._same:
            return None
        if self.framed and zlib.crc32(data[_CRC:-_CRC]) != int.from_bytes(data[-_CRC:], "little"):
            return None
        try:
            return self._root.build(self._reading.unpack_from(data))
        except OverflowError:
            return None

    def write(self, message: Any) -> bytes | None:  # noqa: ANN401
        """Return the datagram of a message; None if its layout is another."""
        values = self._pieces[1::2]
        try:
            if not self._root.take(message, values):
                return None
            self._pieces[1::2] = values
            data = self._writing.pack(*self._pieces)
        except (struct.error, TypeError):
            return None  # the codec says what is wrong
        if self.framed:
            data += zlib.crc32(data[_CRC:]).to_bytes(_CRC, "little")
        return data


class Template(Generic[Message]):
    """Reads and writes one kind of message, fast where the layout is that of an earlier one."""

    def __init__(self, layout: Layout, version: Version) -> None:
        self._layout, self._generation = layout, version.generation
        self._by_length: dict[int, _Learned] = {}
        self._written: list[_Learned] = []

    def decode(self, data: bytes) -> Message:
        """Return the message of a datagram.

        Raises:
            WireFormatError: It is none; the offset says where.
        """
        learned = self._by_length.get(len(data))
        if learned is not None and (message := learned.read(data)) is not None:
            return message
        trace: Trace = []
        message = decode(data, self._layout, self._generation, trace)
        if len(self._by_length) >= MOST_LAYOUTS:
            self._by_length.clear()
        self._by_length[len(data)] = _Learned(data, message, trace, self._generation)
        return message

    def encode(self, message: Message) -> bytes:
        """Return the datagram of a message.

        Raises:
            WireFormatError: The version has no such value, or it does not fit.
        """
        for k, learned in enumerate(self._written):
            if (data := learned.write(message)) is not None:
                if k:
                    self._written.insert(0, self._written.pop(k))
                return data
        data = encode(message, self._layout, self._generation)
        trace: Trace = []
        decode(data, self._layout, self._generation, trace)
        self._written.insert(0, _Learned(data, message, trace, self._generation))
        del self._written[MOST_LAYOUTS // 8 :]
        return data


class MonitoringTemplate(Template[Monitoring]):
    """What the robot says."""

    def __init__(self, version: Version) -> None:
        super().__init__(LAYOUTS[version.generation].monitoring, version)


class CommandTemplate(Template[Command]):
    """What the client answers."""

    def __init__(self, version: Version) -> None:
        super().__init__(LAYOUTS[version.generation].command, version)


def _node(message: Any, trace: Trace, path: Path) -> _Node:  # noqa: ANN401
    """Sort the values of a message into those that change and those that must not."""
    node, depth = _Node(message), len(path)
    places: dict[str, list[int]] = {}
    inner: set[str] = set()
    for at, (where, _, _) in enumerate(trace):
        if where[:depth] == path:
            name = where[depth]
            if len(where) == depth + 1:
                places.setdefault(name, []).append(at)
            else:
                inner.add(name)
    for name, value in vars(message).items():
        here = (*path, name)
        if name in inner and isinstance(value, tuple):
            items = [_node(item, trace, (*here, str(k))) for k, item in enumerate(value)]  # pyright: ignore[reportUnknownArgumentType, reportUnknownVariableType]
            node.lists.append((name, items))
        elif name in inner:
            node.children.append((name, _node(value, trace, here)))
        elif name not in places:
            node.fixed.append((name, value))
        elif isinstance(value, tuple):
            node.arrays.append((name, places[name][0], places[name][-1] + 1))
        elif name in CHANGING:
            node.counters.append((name, places[name][0]))
        else:
            node.numbers.append((name, places[name][0]))
    return node


def _same(one: Any, other: Any) -> bool:  # noqa: ANN401
    """Say whether two values have the same bytes; 0.0 and -0.0 have not."""
    return one == other and (not isinstance(one, tuple) or repr(one) == repr(other))  # pyright: ignore[reportUnknownArgumentType]


def _counter(written: bytes) -> int:
    """Return the integer of a varint that is known to end in its last byte."""
    value = written[0] & 0x7F
    for k, byte in enumerate(written[1:], start=1):
        value |= (byte & 0x7F) << 7 * k
    if value > _HIGHEST:
        raise OverflowError
    return value
