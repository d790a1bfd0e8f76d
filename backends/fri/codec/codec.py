"""FRI messages to bytes and back.

```python
state = decode_monitoring(datagram)  # of whatever version the bytes are
answer = encode_command(Command(Header(0, state.header.sequence)), FriVersion.named("1.15"))
```

Messages to bytes, as an unmodified peer of the generation writes them.

Joint arrays are written unpacked, one tag before each number, and vectors and poses packed; fields
stand in the order of their numbers.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from backends.fri.codec.decoding import Path, decode, said
from backends.fri.codec.layouts import LAYOUTS, Kind, Layout, Part
from backends.fri.codec.messages import MAX_DATAGRAM, MAX_NAME
from backends.fri.codec.version import (
    FIXED64,
    VARINT,
    FriVersion,
    Generation,
    delimited,
    detect,
    double,
    frame,
    tag,
    varint,
)
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.fri.codec.messages import Command, Monitoring

Version: TypeAlias = FriVersion | Generation
_MASK64: Final = (1 << 64) - 1
_INT32: Final = (-(1 << 31), (1 << 31) - 1)
_RANGES: Final = {
    Kind.INT32: _INT32,
    Kind.ENUM: _INT32,
    Kind.UINT32: (0, (1 << 32) - 1),
    Kind.UINT64: (0, _MASK64),
}


def decode_monitoring(data: bytes, version: Version | None = None) -> Monitoring:
    """Decode the robot's monitoring message.

    Args:
        data: One datagram.
        version: Told from the bytes if not given; 1.x where they do not say.

    Raises:
        WireFormatError: No monitoring message of that version.
    """
    generation = (detect(data) or Generation.ONE) if version is None else version.generation
    return decode(data, LAYOUTS[generation].monitoring, generation)


def decode_command(data: bytes, version: Version) -> Command:
    """Decode a client's command message.

    Raises:
        WireFormatError: No command of that version.
    """
    return decode(data, LAYOUTS[version.generation].command, version.generation)


def encode_monitoring(message: Monitoring, version: Version) -> bytes:
    """Encode the robot's monitoring message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, LAYOUTS[version.generation].monitoring, version.generation)


def encode_command(message: Command, version: Version) -> bytes:
    """Encode a client's command message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, LAYOUTS[version.generation].command, version.generation)


def encode(message: Any, layout: Layout, generation: Generation) -> bytes:  # noqa: ANN401  # the layout's value
    """Return the datagram of a value."""
    payload = _message(message, layout, (generation.value,))
    data = frame(payload) if generation.framed else payload
    if len(data) > MAX_DATAGRAM:
        raise WireFormatError(f"message of {len(data)} bytes, at most {MAX_DATAGRAM}", MAX_DATAGRAM)
    return data


def _message(message: Any, layout: Layout, path: Path) -> bytes:  # noqa: ANN401
    known = {part.name for part in layout.parts}
    for name, value in vars(message).items():
        if name not in known and value not in (None, ()):
            raise WireFormatError(f"FRI {path[0]} has no {said((*path[1:], name))}", 0)
    out = bytearray()
    for part in layout.parts:
        if part.kind is Kind.IDENTIFIER:
            out += tag(part.number, VARINT) + varint(part.of)
            continue
        value, where = getattr(message, part.name), (*path, part.name)
        if part.most is not None:
            if len(value) > part.most:
                raise WireFormatError(
                    f"{said(where[1:])} has {len(value)} values, at most {part.most}", len(out)
                )
            for item in value:
                out += _field(item, part, where)
        elif value is not None:
            out += _field(value, part, where)
    return bytes(out)


def _field(value: Any, part: Part, path: Path) -> bytes:  # noqa: ANN401
    """Return one value with its tag."""
    if part.kind is Kind.MESSAGE:
        if part.of.value is int:  # a message of one number
            return delimited(part.number, _field(value, part.of.parts[0], path))
        return delimited(part.number, _message(value, part.of, path))
    try:
        return _number(value, part, path)
    except (TypeError, ValueError, OverflowError, struct.error) as error:
        if isinstance(error, WireFormatError):
            raise
        raise WireFormatError(
            f"{said(path[1:])} = {value!r} cannot be written: {error}", 0
        ) from None


def _number(value: Any, part: Part, path: Path) -> bytes:  # noqa: ANN401
    """Return numbers or text with their tag."""
    if part.kind is Kind.JOINTS:
        return delimited(part.number, _tagged(value, part, path))
    if part.kind is Kind.VECTOR:
        return delimited(part.number, delimited(1, _packed(value, part, path)))
    if part.kind is Kind.DOUBLES:
        return delimited(part.number, _packed(value, part, path))
    if part.kind is Kind.DOUBLE:
        return tag(part.number, FIXED64) + double(value)
    if part.kind is Kind.TEXT:
        return delimited(part.number, _name(value, path))
    lowest, highest = _RANGES[part.kind]
    if not lowest <= value <= highest:
        raise WireFormatError(f"{said(path[1:])} = {value} is outside {lowest} to {highest}", 0)
    # A negative number has 64 bits in a varint.
    return tag(part.number, VARINT) + varint(int(value) & _MASK64)


def _tagged(values: Sequence[float], part: Part, path: Path) -> bytes:
    before = tag(1, FIXED64)
    return b"".join(before + double(value) for value in _counted(values, part, path))


def _packed(values: Sequence[float], part: Part, path: Path) -> bytes:
    return b"".join(map(double, _counted(values, part, path)))


def _counted(values: Sequence[float], part: Part, path: Path) -> Sequence[float]:
    if len(values) != part.of:
        raise WireFormatError(f"{said(path[1:])} has {len(values)} values, expected {part.of}", 0)
    return values


def _name(text: str, path: Path) -> bytes:
    encoded = text.encode()
    if len(encoded) > MAX_NAME:
        raise WireFormatError(
            f"{said(path[1:])} = {text!r} has {len(encoded)} bytes, at most {MAX_NAME}", 0
        )
    return encoded
