"""Bytes to messages, as strictly as a robot deserves.

Decoding raises `WireFormatError` with the offset and nothing else, whatever the bytes are. It takes
joint arrays packed or unpacked, padded integers, fields in any order and fields that it does not
know; it refuses arrays of another length than the protocol's, since decoders of the field go out of
step on those without a word. Where a field comes twice, the last one counts and messages merge, as
protobuf has it. An optional enum with a value that is not known is left out; a required one is an
error.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeAlias

from backends.fri.codec.layouts import CHANGING, Kind, Layout, Part
from backends.fri.codec.messages import COMMAND_ID, MAX_DATAGRAM, MAX_NAME, MONITORING_ID
from backends.fri.codec.version import (
    FIXED64,
    LENGTH_DELIMITED,
    TYPE_NAMES,
    VARINT,
    Field,
    fields_of,
    framed,
    read_double,
    read_varint,
    unframed,
)
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.fri.codec.version import Generation

Path: TypeAlias = tuple[str, ...]  # of attributes, from the message down
# Where a number that changes from cycle to cycle stands: first byte, one after the last.
Trace: TypeAlias = list[tuple[Path, int, int]]

_MASK32: Final = (1 << 32) - 1
_HIGHEST: Final = {Kind.UINT64: (1 << 64) - 1, Kind.INT32: (1 << 31) - 1}
_IDENTIFIERS: Final = {MONITORING_ID: "monitoring message", COMMAND_ID: "command"}
_MESSAGES: Final = frozenset({Kind.TEXT, Kind.MESSAGE, Kind.JOINTS, Kind.VECTOR})


def decode(data: bytes, layout: Layout, generation: Generation, trace: Trace | None = None) -> Any:  # noqa: ANN401  # the layout's value
    """Return the value of one datagram; `trace` collects where its numbers stand."""
    if len(data) > MAX_DATAGRAM:
        raise WireFormatError(
            f"datagram of {len(data)} bytes, at most {MAX_DATAGRAM}", MAX_DATAGRAM
        )
    if generation.framed:
        start, stop = unframed(data)
    elif framed(data):
        raise WireFormatError(f"framed as in 2.7, expected bare as in {generation.value}", 0)
    else:
        start, stop = 0, len(data)
    return _message(data, [(start, stop)], layout, (), trace)


def _message(
    data: bytes,
    spans: Sequence[tuple[int, int]],
    layout: Layout,
    path: Path,
    trace: Trace | None,
) -> Any:  # noqa: ANN401  # the layout's value
    """Return one message whose fields stand in one span, or in several that merge."""
    parts = layout.by_number
    found: dict[int, list[Field]] = {}
    for start, stop in spans:
        for field in fields_of(data, start, stop):
            if field.number in parts:
                found.setdefault(field.number, []).append(field)
    values: dict[str, Any] = {}
    for part in layout.parts:
        fields, where = found.get(part.number), (*path, part.name)
        value = None if fields is None else _value(data, fields, part, where, trace)
        if value is None and part.required:
            raise WireFormatError(f"{said(where)} is missing", spans[0][0])
        if part.name and value is not None:
            values[part.name] = value
    if layout.value is int:  # a message of one number
        return values.get(layout.parts[0].name)
    return layout.value(**values)


def _value(data: bytes, fields: list[Field], part: Part, path: Path, trace: Trace | None) -> Any:  # noqa: ANN401
    """Return what the fields of one number say, None where that is nothing."""
    if part.kind is Kind.DOUBLES:
        return _doubles(data, fields, part, path, trace)
    for field in fields:
        _check_type(field, part, path)
    if part.most is not None:
        return _repeated(data, fields, part, path, trace)
    if part.kind is Kind.MESSAGE:
        return _message(data, [(f.start, f.stop) for f in fields], part.of, path, trace)
    return _single(data, fields, part, path, trace)


def _single(data: bytes, fields: list[Field], part: Part, path: Path, trace: Trace | None) -> Any:  # noqa: ANN401
    last = fields[-1]
    if part.kind in {Kind.JOINTS, Kind.VECTOR}:
        inside = [f for field in fields for f in fields_of(data, field.start, field.stop)]
        return _doubles(data, [f for f in inside if f.number == 1], part, path, trace, last.at)
    if part.kind is Kind.TEXT:
        return _text(data, last, path)
    if part.kind is Kind.DOUBLE or part.name in CHANGING:
        _note(trace, path, last.start, last.stop)
    if part.kind is Kind.DOUBLE:
        return read_double(data, last.start)
    known = [_integer(field, part, path) for field in fields]
    return next((value for value in reversed(known) if value is not None), None)


def _check_type(field: Field, part: Part, path: Path) -> None:
    if part.kind in _MESSAGES:
        expected = LENGTH_DELIMITED
    else:
        expected = FIXED64 if part.kind is Kind.DOUBLE else VARINT
    packed = part.most is not None and field.type == LENGTH_DELIMITED
    if field.type != expected and not packed:
        raise WireFormatError(
            f"{said(path)} is {TYPE_NAMES[field.type]}, expected {TYPE_NAMES[expected]}", field.at
        )


def _repeated(
    data: bytes, fields: list[Field], part: Part, path: Path, trace: Trace | None
) -> tuple[Any, ...]:
    values: list[Any] = []
    for field in fields:
        if part.kind is Kind.MESSAGE:
            where = (*path, str(len(values)))
            values.append(_message(data, [(field.start, field.stop)], part.of, where, trace))
        else:
            values += [_integer(item, part, path) for item in _unpacked(data, field)]
    if part.most is not None and len(values) > part.most:
        raise WireFormatError(
            f"{said(path)} has {len(values)} values, at most {part.most}", fields[0].at
        )
    return tuple(value for value in values if value is not None)


def _unpacked(data: bytes, field: Field) -> list[Field]:
    """Return the integers of a field, which may be packed."""
    if field.type == VARINT:
        return [field]
    items: list[Field] = []
    at = field.start
    while at < field.stop:
        value, after = read_varint(data, at, field.stop)
        items.append(Field(field.number, VARINT, at, at, after, value))
        at = after
    return items


def _doubles(
    data: bytes, fields: list[Field], part: Part, path: Path, trace: Trace | None, at: int = 0
) -> tuple[float, ...]:
    """Return an array of doubles, packed or not; only a vector may be short."""
    offsets: list[int] = []
    for field in fields:
        size = field.stop - field.start
        if field.type not in {FIXED64, LENGTH_DELIMITED} or size % 8:
            raise WireFormatError(f"{said(path)} is no array of doubles", field.at)
        offsets += range(field.start, field.stop, 8)
    count = len(offsets)
    if count != part.of and not (part.kind is Kind.VECTOR and count < part.of):
        raise WireFormatError(
            f"{said(path)} has {count} values, expected {part.of}", fields[0].at if fields else at
        )
    for offset in offsets:
        _note(trace, path, offset, offset + 8)
    return tuple(read_double(data, offset) for offset in offsets)


def _text(data: bytes, field: Field, path: Path) -> str:
    size = field.stop - field.start
    if size > MAX_NAME:
        raise WireFormatError(f"{said(path)} has {size} bytes, at most {MAX_NAME}", field.at)
    try:
        return data[field.start : field.stop].decode()
    except UnicodeDecodeError as error:
        raise WireFormatError(f"{said(path)} is no UTF-8", field.start + error.start) from None


def _integer(field: Field, part: Part, path: Path) -> int | None:
    """Return an integer in the range of its type; None for an unknown value of an enum."""
    value, kind = field.value, part.kind
    if kind in {Kind.INT32, Kind.ENUM} and value >> 31 in {1, (1 << 33) - 1}:
        value = (value & _MASK32) - (1 << 32)  # negative, written with 32 or with 64 bits
    if value > _HIGHEST.get(kind, _MASK32):
        raise WireFormatError(f"{said(path)} = {value} does not fit into {kind.value}", field.at)
    if kind is Kind.ENUM:
        return next((known for known in part.of if known == value), None)
    if kind is Kind.IDENTIFIER and value != part.of:
        given = _IDENTIFIERS.get(value, "no message of FRI")
        raise WireFormatError(
            f"identifier {value:#x} ({given}), expected {part.of:#x} ({_IDENTIFIERS[part.of]})",
            field.at,
        )
    return value


def _note(trace: Trace | None, path: Path, start: int, stop: int) -> None:
    if trace is not None:
        trace.append((path, start, stop))


def said(path: Path) -> str:
    """Return a path of attributes as a user reads it."""
    return ".".join(name or "identifier" for name in path)
