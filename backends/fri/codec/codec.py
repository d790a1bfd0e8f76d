"""FRI messages to bytes and back, by protobuf's own parser, as strictly as a robot deserves.

```python
state = decode_monitoring(datagram)  # of whatever version the bytes are
answer = encode_command(Command(Header(0, state.header.sequence)), FriVersion.named("1.15"))
```

Decoding raises `WireFormatError` and nothing else, whatever the bytes are. As protobuf has it,
joint arrays may be packed or not, integers padded, fields in any order, and some unknown; where a
field comes twice, the last one counts and messages merge. What protobuf lets pass is refused:
arrays of another length than the protocol's, since decoders of the field go out of step on those
without a word, messages without what they need, integers out of range, and fields of another type
than theirs. An enum with a value that is not known is left out, or missing where it is required.

Protobuf's own parsers of FRI's messages, one for each generation, made of the messages' fields.

Integers and enums are parsed as 64 bits, so that none is cut to fit; the codec checks what they
have to be.
"""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, TypeAlias, get_args, get_type_hints

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
    MisfitError,
    Nested,
    Part,
    Several,
    Text,
)
from backends.fri.codec.messages import HEADER_TAG, FriVersion, Generation, frame, framed, unframed
from limo_driver.errors import WireFormatError

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


Version: TypeAlias = FriVersion | Generation
_IDENTIFIERS: Final[dict[Any, int]] = {m.Monitoring: m.MONITORING_ID, m.Command: m.COMMAND_ID}
_KINDS: Final = {m.MONITORING_ID: "monitoring message", m.COMMAND_ID: "command"}


def decode_monitoring(data: bytes, version: Version | None = None) -> m.Monitoring:
    """Decode the robot's monitoring message.

    Args:
        data: One datagram.
        version: Told from the bytes if not given; 1.x where they do not say.

    Raises:
        WireFormatError: No monitoring message of that version.
    """
    generation = (detect(data) or Generation.ONE) if version is None else version.generation
    return decode(data, m.Monitoring, generation)


def decode_command(data: bytes, version: Version) -> m.Command:
    """Decode a client's command message.

    Raises:
        WireFormatError: No command of that version.
    """
    return decode(data, m.Command, version.generation)


def encode_monitoring(message: m.Monitoring, version: Version) -> bytes:
    """Encode the robot's monitoring message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, version.generation)


def encode_command(message: m.Command, version: Version) -> bytes:
    """Encode a client's command message.

    Raises:
        WireFormatError: The version has no such value, or it does not fit.
    """
    return encode(message, version.generation)


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
        raise WireFormatError("neither a bare nor a framed FRI message")
    for generation, names in (
        (Generation.ONE, ["commanded_position"]),
        (Generation.TWO_FIVE, ["measured_pose", "measured_redundancy"]),
    ):
        data = MESSAGES[generation][m.Monitoring].parse(datagram).data
        if any(data.HasField(name) for name in names):
            return generation
    return None


def payload_of(data: bytes, generation: Generation) -> bytes:
    """Return the protobuf in a datagram.

    Raises:
        WireFormatError: It is too large, or not framed as the generation has it.
    """
    if len(data) > m.MAX_DATAGRAM:
        raise WireFormatError(f"datagram of {len(data)} bytes, at most {m.MAX_DATAGRAM}")
    if generation.framed:
        return unframed(data)
    if framed(data):
        raise WireFormatError(f"framed as in 2.7, expected bare as in {generation.value}")
    return data


def decode(data: bytes, kind: Any, generation: Generation) -> Any:  # of that class
    """Return the message of a class that a datagram is."""
    codec, expected = MESSAGES[generation][kind], _IDENTIFIERS[kind]
    payload = payload_of(data, generation)
    part = codec.parse(payload, (len(data) - len(payload)) // 2)
    given = part.header.identifier
    if given != expected and part.header.HasField("identifier"):
        raise WireFormatError(
            f"identifier {given:#x} ({_KINDS.get(given, 'no message of FRI')}), "
            f"expected {expected:#x} ({_KINDS[expected]})"
        )
    try:
        message = codec.read(part)
    except MisfitError as misfit:
        raise WireFormatError(str(misfit)) from None
    if given != expected:
        raise WireFormatError("header.identifier is missing")
    return message


def encode(message: m.Monitoring | m.Command, generation: Generation) -> bytes:
    """Return the datagram of a message, as an unmodified peer of the generation writes it."""
    return datagram_of(protobuf_of(message, generation), generation)


def protobuf_of(message: m.Monitoring | m.Command, generation: Generation) -> Any:
    """Return protobuf's message of a value."""
    codec = MESSAGES[generation][type(message)]
    part = codec.parser()
    part.header.identifier = _IDENTIFIERS[type(message)]
    try:
        codec.write(part, message)
    except MisfitError as misfit:
        raise WireFormatError(str(misfit)) from None
    return part


def datagram_of(part: Any, generation: Generation) -> bytes:
    """Return the datagram of protobuf's message."""
    payload = part.SerializeToString()
    data = frame(payload) if generation.framed else payload
    if len(data) > m.MAX_DATAGRAM:
        raise WireFormatError(f"message of {len(data)} bytes, at most {m.MAX_DATAGRAM}")
    return data
