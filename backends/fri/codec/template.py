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
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, Generic, Protocol, TypeVar

from backends.fri.codec.codec import encode
from backends.fri.codec.decoding import decode
from backends.fri.codec.layouts import CHANGING, LAYOUTS, Layout
from backends.fri.codec.messages import Command, Monitoring
from backends.fri.codec.version import varint

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.fri.codec.codec import Version
    from backends.fri.codec.decoding import Path, Trace
    from backends.fri.codec.version import Generation

MOST_LAYOUTS: Final = 32  # that are remembered
_HIGHEST: Final = (1 << 32) - 1
_CRC: Final = 4  # bytes

Message = TypeVar("Message", Monitoring, Command)


class _Part(Protocol):
    """A value that changes from cycle to cycle."""

    def read(self, values: tuple[Any, ...], /) -> Any:
        """Return the value of a datagram whose numbers are `values`."""

    def write(self, value: Any, pieces: list[Any], /) -> bool:
        """Put a value among the pieces of a datagram; False if the layout is another.

        Numbers have the odd places, what stands between them the even ones.
        """
        ...


class _Node:
    """Recipe that builds one message of a layout from the values of a datagram.

    Args:
        like: The message that the layout was learned from.
        fixed: What must not change, by name.
        parts: What changes, by name.
    """

    def __init__(self, like: Any, fixed: dict[str, Any], parts: dict[str, _Part]) -> None:
        self._kind, self._content = type(like), dict(vars(like))
        self._fixed = list(fixed.items())
        self._reads = [(name, part.read) for name, part in parts.items()]
        self._writes = [(name, part.write) for name, part in parts.items()]

    def read(self, values: tuple[Any, ...]) -> Any:
        content = self._content.copy()
        for name, read in self._reads:
            content[name] = read(values)
        made = object.__new__(self._kind)  # frozen: its constructor is several times slower
        object.__setattr__(made, "__dict__", content)
        return made

    def write(self, message: Any, pieces: list[Any]) -> bool:
        if type(message) is not self._kind:
            return False
        content: dict[str, Any] = message.__dict__
        for name, like in self._fixed:
            if content[name] is not like and not _same(content[name], like):
                return False
        for name, write in self._writes:  # noqa: SIM110  # a generator would take as long again
            if not write(content[name], pieces):
                return False
        return True


class _Nodes:
    """Messages that repeat."""

    def __init__(self, nodes: list[_Node]) -> None:
        self._nodes = nodes

    def read(self, values: tuple[Any, ...]) -> Any:
        return tuple([node.read(values) for node in self._nodes])

    def write(self, messages: Any, pieces: list[Any]) -> bool:
        return len(messages) == len(self._nodes) and all(
            node.write(message, pieces) for node, message in zip(self._nodes, messages, strict=True)
        )


class _Doubles:
    """An array."""

    def __init__(self, start: int, stop: int) -> None:
        self.read: Callable[[tuple[Any, ...]], Any] = itemgetter(slice(start, stop))
        self._length, self._places = stop - start, slice(2 * start + 1, 2 * stop, 2)

    def write(self, numbers: Any, pieces: list[Any]) -> bool:
        if numbers is None or len(numbers) != self._length:
            return False
        pieces[self._places] = numbers
        return True


class _Double:
    """One number."""

    def __init__(self, at: int) -> None:
        self.read: Callable[[tuple[Any, ...]], Any] = itemgetter(at)
        self._place = 2 * at + 1

    def write(self, number: Any, pieces: list[Any]) -> bool:
        pieces[self._place] = number
        return number is not None


class _Counter:
    """An integer of as many bytes as the layout was learned with."""

    def __init__(self, at: int, length: int) -> None:
        self._at, self._length = at, length

    def read(self, values: tuple[Any, ...]) -> int:
        value = 0
        for byte in reversed(values[self._at]):
            value = value << 7 | byte & 0x7F
        if value > _HIGHEST:
            raise OverflowError
        return value

    def write(self, number: int, pieces: list[Any]) -> bool:
        written = varint(number) if 0 <= number <= _HIGHEST else b""
        pieces[2 * self._at + 1] = written
        return len(written) == self._length


class _Learned:
    """The layout of one datagram."""

    def __init__(self, data: bytes, message: Any, trace: Trace, generation: Generation) -> None:
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

    def read(self, data: bytes) -> Any:
        """Return the message of a datagram of this length; None if its layout is another."""
        if int.from_bytes(data, "little") & self._mask != self._same:
            return None
        if self.framed and zlib.crc32(data[_CRC:-_CRC]) != int.from_bytes(data[-_CRC:], "little"):
            return None
        try:
            return self._root.read(self._reading.unpack_from(data))
        except OverflowError:
            return None

    def write(self, message: Any) -> bytes | None:
        """Return the datagram of a message; None if its layout is another."""
        try:
            if not self._root.write(message, self._pieces):
                return None
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
    """Template of the robot's monitoring message."""

    def __init__(self, version: Version) -> None:
        super().__init__(LAYOUTS[version.generation].monitoring, version)


class CommandTemplate(Template[Command]):
    """Template of the client's command message."""

    def __init__(self, version: Version) -> None:
        super().__init__(LAYOUTS[version.generation].command, version)


def _node(message: Any, trace: Trace, path: Path) -> _Node:
    """Sort the values of a message into those that change and those that must not."""
    depth = len(path)
    places: dict[str, list[int]] = {}
    inner: set[str] = set()
    for at, (where, _, _) in enumerate(trace):
        if where[:depth] == path:
            name = where[depth]
            if len(where) == depth + 1:
                places.setdefault(name, []).append(at)
            else:
                inner.add(name)
    fixed: dict[str, Any] = {}
    parts: dict[str, _Part] = {}
    for name, value in vars(message).items():
        here = (*path, name)
        if name in inner and isinstance(value, tuple):
            items: Any = value
            parts[name] = _Nodes(
                [_node(item, trace, (*here, str(k))) for k, item in enumerate(items)]
            )
        elif name in inner:
            parts[name] = _node(value, trace, here)
        elif name not in places:
            fixed[name] = value
        elif isinstance(value, tuple):
            parts[name] = _Doubles(places[name][0], places[name][-1] + 1)
        elif name in CHANGING:
            at = places[name][0]
            parts[name] = _Counter(at, trace[at][2] - trace[at][1])
        else:
            parts[name] = _Double(places[name][0])
    return _Node(message, fixed, parts)


def _same(one: Any, other: Any) -> bool:
    """Say whether two values have the same bytes; 0.0 and -0.0 have not."""
    return one == other and (not isinstance(one, tuple) or repr(one) == repr(other))  # pyright: ignore[reportUnknownArgumentType]
