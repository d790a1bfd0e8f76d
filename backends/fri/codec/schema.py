"""Protobuf's own parsers of FRI's messages, one for each generation, made of the messages' fields.

Integers and enums are parsed as 64 bits, so that none is cut to fit; the codec checks what they
have to be.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, get_args, get_type_hints

from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from backends.fri.codec import messages as m
from backends.fri.codec.fields import (
    Absent,
    Choice,
    Doubles,
    Integer,
    Message,
    Nested,
    Part,
    Several,
    Text,
)
from backends.fri.codec.version import Generation

if TYPE_CHECKING:
    from google.protobuf.descriptor_pb2 import DescriptorProto

KINDS: Final = (  # what is inside others before them
    m.Header, m.Timestamp, m.IoValue, m.Transformation, m.Redundancy, m.RobotInfo, m.MonitorData,
    m.ConnectionInfo, m.IpoData, m.Checksum, m.EndOfMessage, m.Monitoring, m.CommandData, m.Command,
)  # fmt: skip
_ONCE, _REPEATED = FieldDescriptorProto.LABEL_OPTIONAL, FieldDescriptorProto.LABEL_REPEATED
_MESSAGE: Final = FieldDescriptorProto.TYPE_MESSAGE
_TYPES: Final = {
    float: FieldDescriptorProto.TYPE_DOUBLE,
    str: FieldDescriptorProto.TYPE_BYTES,  # the codec says which one is no UTF-8
    int: FieldDescriptorProto.TYPE_UINT64,
}


def _messages(generation: Generation) -> dict[Any, Message]:
    """Return all messages of a generation, by the class of their values."""
    file = FileDescriptorProto(name="fri.proto", package="fri", syntax="proto2")
    for kind in KINDS:
        declared = file.message_type.add(name=kind.__name__)
        if kind is m.Header:
            _declare(declared, "identifier", m.Wire(1), int)
        for name, (wire, of) in _hints(kind, generation).items():
            if wire is not None:
                _declare(declared, name, wire, of)
    pool = DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    made: dict[Any, Message] = {}
    for kind in KINDS:
        parser = GetMessageClass(pool.FindMessageTypeByName(f"fri.{kind.__name__}"))
        made[kind] = Message(kind, _parts(kind, generation, made), parser)
    return made


def _hints(kind: Any, generation: Generation) -> dict[str, tuple[m.Wire | None, Any]]:
    """Return where each field stands, None for nowhere, and the class of its values."""
    found: dict[str, tuple[m.Wire | None, Any]] = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        of = hint.__origin__
        while inside := get_args(of):  # of an optional value, of a tuple
            of = inside[0]
        wires = (wire for wire in hint.__metadata__ if generation in wire.only)
        found[name] = next(wires, None), of
    return found


def _parts(kind: Any, generation: Generation, made: dict[Any, Message]) -> list[Part]:
    """Return the fields of a message."""
    parts: list[Part] = []
    for name, (wire, of) in _hints(kind, generation).items():
        required = name not in kind._field_defaults
        if wire is None:
            parts.append(Absent(name, generation.value))
        elif of is float:
            parts.append((Part if wire.most is None else Doubles)(name, wire, required=required))
        else:
            part = _part(name, wire, of, made, required=required)
            parts.append(part if wire.most is None else Several(part))
    return parts


def _part(name: str, wire: m.Wire, of: Any, made: dict[Any, Message], *, required: bool) -> Part:
    if of in made:
        return Nested(name, wire, made[of], required=required)
    if issubclass(of, IntEnum):
        return Choice(name, wire, of, required=required)
    return (Integer if of is int else Text)(name, wire, required=required)


def _declare(declared: DescriptorProto, name: str, wire: m.Wire, of: Any) -> None:
    """Declare a field to protobuf."""
    number = wire.number
    if wire.wrapped:
        inner = declared.nested_type.add(name=f"Of_{name}")
        path = f".fri.{declared.name}.{inner.name}"
        declared.field.add(name=name, number=number, label=_ONCE, type=_MESSAGE, type_name=path)
        declared, name, number = inner, "values", 1
    kind = int if issubclass(of, IntEnum) else of
    label = _ONCE if wire.most is None else _REPEATED
    added = declared.field.add(name=name, number=number, label=label)
    added.type = _TYPES.get(kind, _MESSAGE)
    if kind not in _TYPES:
        added.type_name = f".fri.{kind.__name__}"
    if wire.packed:
        added.options.packed = True


MESSAGES: Final = {generation: _messages(generation) for generation in Generation}
