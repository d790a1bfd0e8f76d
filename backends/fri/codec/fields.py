"""Each kind of field that FRI's messages have: from what protobuf parsed to a value, and back."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, Final

from google.protobuf.message import DecodeError
from google.protobuf.unknown_fields import UnknownFieldSet

from backends.fri.codec import messages as m
from limo_driver.errors import WireFormatError

_MASK32, _MASK64 = (1 << 32) - 1, (1 << 64) - 1
_NEGATIVE: Final = {1, (1 << 33) - 1}  # upper bits of a number that was written with 32 bits, or 64
_TYPES: Final = (
    "integer", "double", "message or text", "group", "end of a group", "float", "type 6", "type 7"
)  # fmt: skip
_READ: Final = {0, 1, 2, 5}  # of these
_SIZES: Final = {1: 8, 5: 4}  # bytes, of the types of field that have no length
_LONGEST: Final = 10  # bytes of an integer
_NUMBERS: Final = range(1, 1 << 29)  # of fields


class MisfitError(Exception):
    """A value that does not fit.

    Args:
        path: Of the value; whoever passes this on puts a name before it.
        why: What is wrong.
        before: What is said before the path.
    """

    def __init__(self, path: str, why: str, before: str = "") -> None:
        self.path, self.why, self.before = path, why, before
        super().__init__(path, why, before)

    def __str__(self) -> str:
        return f"{self.before}{self.path}{self.why}"

    def inside(self, name: str) -> MisfitError:
        """Return the same of a message that has the value."""
        return MisfitError(f"{name}.{self.path}", self.why, self.before)


class Part:
    """A field that comes once: here, a double."""

    is_number = True  # or several

    def __init__(self, name: str, wire: m.Wire, *, required: bool = False) -> None:
        self.name, self.wire, self.required = name, wire, required

    def read(self, part: Any) -> Any:
        """Return the value in a message of protobuf; None if it is not there."""
        return self.taken(getattr(part, self.name)) if part.HasField(self.name) else None

    def write(self, part: Any, value: Any) -> None:
        """Put a value into a message of protobuf."""
        setattr(part, self.name, self.given(value))

    def writer(self, part: Any) -> Callable[[Any], None]:
        """Return what puts values into a message of protobuf, one after the other."""
        return partial(self.write, part)

    def taken(self, raw: Any) -> Any:
        """Return the value of what protobuf parsed."""
        return raw

    def given(self, value: Any) -> Any:
        """Return what protobuf writes of a value."""
        return value

    def misfit(self, why: str) -> MisfitError:
        """Say what is wrong with a value."""
        return MisfitError(self.name, why)


class Integer(Part):
    """An integer of a range."""

    def taken(self, raw: int) -> int:
        lowest, highest = self.wire.span
        if lowest < 0 and raw >> 31 in _NEGATIVE:
            raw = (raw & _MASK32) - (1 << 32)
        if not lowest <= raw <= highest:
            raise self.misfit(f" = {raw} is outside {lowest} to {highest}")
        return raw

    def given(self, value: int) -> int:
        lowest, highest = self.wire.span
        if not lowest <= value <= highest:
            raise self.misfit(f" = {value} is outside {lowest} to {highest}")
        return value & _MASK64  # a negative number has 64 bits


class Choice(Part):
    """A value of an enum; one that is not known is left out."""

    is_number = False

    def __init__(self, name: str, wire: m.Wire, of: Any, *, required: bool) -> None:
        super().__init__(name, wire, required=required)
        self._known = {int(known): known for known in of}

    def taken(self, raw: int) -> Any:
        return self._known.get(raw)

    def given(self, value: int) -> int:
        return int(value)


class Text(Part):
    """A name."""

    is_number = False

    def taken(self, raw: bytes) -> str:
        if len(raw) > m.MAX_NAME:
            raise self.misfit(f" has {len(raw)} bytes, at most {m.MAX_NAME}")
        try:
            return raw.decode()
        except UnicodeDecodeError:
            raise self.misfit(" is no UTF-8") from None

    def given(self, value: str) -> bytes:
        raw = value.encode()
        if len(raw) > m.MAX_NAME:
            raise self.misfit(f" = {value!r} has {len(raw)} bytes, at most {m.MAX_NAME}")
        return raw


class Doubles(Part):
    """An array of numbers; only a vector may be short, and only where it is read."""

    def __init__(self, name: str, wire: m.Wire, *, required: bool) -> None:
        super().__init__(name, wire, required=required)
        self._values = attrgetter(f"{name}.values" if wire.wrapped else name)
        self._counts = range(wire.fewest, (wire.most or 0) + 1)

    def read(self, part: Any) -> tuple[float, ...] | None:
        count, values = self.wire.most, self._values(part)[:]
        if self.wire.wrapped and part.HasField(self.name):
            try:
                check_unknown(getattr(part, self.name))
            except MisfitError as misfit:
                raise misfit.inside(self.name) from None
        if len(values) != count:
            if not (part.HasField(self.name) if self.wire.wrapped else values):
                return None
            if len(values) not in self._counts:
                raise self.misfit(f" has {len(values)} values, expected {count}")
        return tuple(values)

    def write(self, part: Any, value: Sequence[float]) -> None:
        self.writer(part)(value)

    def writer(self, part: Any) -> Callable[[Any], None]:
        values, count = self._values(part), self.wire.most

        def write(value: Sequence[float]) -> None:
            if len(value) != count:
                raise self.misfit(f" has {len(value)} values, expected {count}")
            values[:] = value

        return write


class Nested(Part):
    """A message in another."""

    is_number = False

    def __init__(self, name: str, wire: m.Wire, of: Message, *, required: bool) -> None:
        super().__init__(name, wire, required=required)
        self.of = of

    def taken(self, raw: Any, index: str = "") -> Any:
        try:
            return self.of.read(raw)
        except MisfitError as misfit:
            raise misfit.inside(self.name + index) from None

    def write(self, part: Any, value: Any) -> None:
        inner = getattr(part, self.name)
        inner.SetInParent()  # an empty one is there, too
        self.put(inner, value)

    def put(self, inner: Any, value: Any, index: str = "") -> None:
        """Put a message into one of protobuf; `index` says which of several."""
        try:
            self.of.write(inner, value)
        except MisfitError as misfit:
            raise misfit.inside(self.name + index) from None


class Several(Part):
    """A field that may come several times.

    Args:
        item: What comes.
    """

    is_number = False

    def __init__(self, item: Part) -> None:
        super().__init__(item.name, item.wire)
        self._item = item

    def read(self, part: Any) -> tuple[Any, ...]:
        raws = getattr(part, self.name)
        self._check(raws)
        if isinstance(item := self._item, Nested):
            return tuple([item.taken(raw, f".{k}") for k, raw in enumerate(raws)])
        values = [item.taken(raw) for raw in raws]
        return tuple([value for value in values if value is not None])

    def write(self, part: Any, value: Sequence[Any]) -> None:
        if not value:
            return
        self._check(value)
        raws, item = getattr(part, self.name), self._item
        for k, one in enumerate(value):
            if isinstance(item, Nested):
                item.put(raws.add(), one, f".{k}")
            else:
                raws.append(item.given(one))

    def _check(self, values: Sequence[Any]) -> None:
        if len(values) > (self.wire.most or 0):
            raise self.misfit(f" has {len(values)} values, at most {self.wire.most}")


class Absent(Part):
    """A field that a generation does not have."""

    def __init__(self, name: str, generation: str) -> None:
        super().__init__(name, m.Wire(0))
        self._before = f"FRI {generation} has no "

    def read(self, part: Any) -> None:
        """Return nothing."""

    def write(self, part: Any, value: Any) -> None:
        raise MisfitError(self.name, "", self._before)


class Message:
    """One message of a generation.

    Args:
        kind: Class of the value.
        parts: Its fields, in their order.
        parser: Protobuf's class.
    """

    def __init__(self, kind: Any, parts: Sequence[Part], parser: Any) -> None:
        self.kind, self.parts, self.parser = kind, parts, parser
        self._writers = [(part.write, part) for part in parts]

    def parse(self, payload: bytes, before: int = 0) -> Any:
        """Return protobuf's message of a datagram that has so many bytes before it."""
        try:
            return self.parser.FromString(payload)
        except DecodeError as error:
            blame(bytes(before) + payload, self.parser.DESCRIPTOR, before)
            raise WireFormatError(f"no message of protobuf: {error}", before) from None

    def read(self, part: Any) -> Any:
        """Return the value of protobuf's message."""
        check_unknown(part)
        values = [field.read(part) for field in self.parts]
        for field, value in zip(self.parts, values, strict=True):
            if value is None and field.required:
                raise field.misfit(" is missing")
        return self.kind._make(values)

    def write(self, part: Any, value: Any) -> None:
        """Put a value into protobuf's message."""
        for (write, field), item in zip(self._writers, value, strict=True):
            if item is not None:
                try:
                    write(part, item)
                except (TypeError, ValueError, OverflowError) as error:
                    raise field.misfit(f" = {item!r} cannot be written: {error}") from None


def check_unknown(part: Any) -> None:
    """Refuse a known field of another type than its own: protobuf takes that for unknown."""
    for unknown in UnknownFieldSet(part):
        number, given = unknown.field_number, _TYPES[unknown.wire_type]
        if (field := part.DESCRIPTOR.fields_by_number.get(number)) is not None:
            expected = _TYPES[{field.TYPE_UINT64: 0, field.TYPE_DOUBLE: 1}.get(field.type, 2)]
            raise MisfitError(field.name, f" is {given}, expected {expected}")
        if given == "group":
            raise MisfitError(f"field {number}", " is a group, of which FRI has none")


def blame(data: bytes, kind: Any, at: int, path: str = "") -> None:
    """Raise for the first field that protobuf cannot read; it says no more than that one is there.

    Args:
        data: Of which nothing comes after the message.
        kind: Protobuf's description of the message.
        at: Where it begins.
        path: Of the message, with a point after it.
    """
    while at < len(data):
        tag, start = _integer(data, at, f"{path}tag")
        number, of_type, size = tag >> 3, tag & 7, 0
        field = kind.fields_by_number.get(number)
        name = path + (f"field {number}" if field is None else field.name)
        if number not in _NUMBERS or of_type not in _READ:
            raise WireFormatError(f"{name} is {_TYPES[of_type]}, of which FRI has none", at)
        if of_type in _SIZES:
            size = _SIZES[of_type]
        else:
            value, start = _integer(data, start, name)
            size = value if of_type else 0
        if (after := start + size - len(data)) > 0:
            raise WireFormatError(f"{name} ends {after} bytes after its message", at)
        at = start + size
        if of_type == 2 and field is not None:  # noqa: PLR2004  # a message, or packed numbers
            _blame_inside(data[:at], field, start, name)


def _blame_inside(data: bytes, field: Any, at: int, name: str) -> None:
    if field.message_type is not None:
        blame(data, field.message_type, at, f"{name}.")
    elif field.type == field.TYPE_DOUBLE and (size := len(data) - at) % _SIZES[1]:
        raise WireFormatError(f"{name} has {size} bytes, which are no doubles", at)
    elif field.type == field.TYPE_UINT64:
        while at < len(data):
            _, at = _integer(data, at, name)


def _integer(data: bytes, at: int, name: str) -> tuple[int, int]:
    """Return an integer and the offset after it."""
    value = 0
    for k, byte in enumerate(data[at : at + _LONGEST]):
        value |= (byte & 0x7F) << 7 * k
        if byte < 0x80:  # noqa: PLR2004  # the last group of seven bits
            return value, at + k + 1
    raise WireFormatError(f"{name} is an integer that does not end", at)
