"""What messages of any ROS 2 type hold, by the definition that a bag carries with them.

Numbers become named columns: `feedback.positions` of a message whose `joint_names` are `a, b` is
`feedback.positions.a` and `feedback.positions.b`; an array without names is `q[0]`, `q[1]`, ...
Definitions are parsed here and interpreted, so that no code is made of what a stranger's file says.

Messages of MCAP files in JSON and protobuf, as Foxglove's SDKs write them: numbers by name.

Protobuf's schemas are descriptors, and protobuf itself reads messages by them; no code is made.
"""

# pyright: reportUnknownParameterType=false
from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, cast

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from limo_driver.errors import WireFormatError
from limo_driver.network.messages.cdr import CdrReader

if TYPE_CHECKING:
    from limo_driver.logs.mcap_file import LoggedMessage


CODES: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_FLOATS: Final = "fd"  # what joints are measured in; modes and flags are not kept
STRING: Final = "string"
LABELS: Final = ("name", "names", "joint_names")  # fields that name what the arrays are of
_TIMES: Final = ("builtin_interfaces/Time", "builtin_interfaces/Duration")
HEADER: Final = "std_msgs/Header"
_FIELD: Final = re.compile(
    r"^(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?P<array>\[(?P<size>(?:<=)?\d*)\])?\s+(?P<name>[A-Za-z]\w*)"
    r"(?P<constant>\s*=)?"
)
MOST: Final = 10_000  # entries of one array, and numbers of one message
DEEPEST: Final = 8  # types within each other


@dataclass(frozen=True)
class MessageField:
    """One field of a message."""

    name: str
    kind: str  # a primitive, or a type of its own
    many: int | None = None  # entries; 0 for any number, None for a single one


@dataclass
class DecodedMessage:
    """The numbers of a message, by column."""

    stamp_ns: int | None = None  # of its header, if it has one
    labels: tuple[str, ...] = ()  # joints that it names
    values: dict[str, float] = field(default_factory=dict)


class MessageLayout:
    """How the bytes of messages of one type are to be read.

    Args:
        name: Of the type, such as `control_msgs/msg/JointTrajectoryControllerState`.
        definition: Its text, as MCAP has it: the type, then each that it is made of.

    Raises:
        WireFormatError: The text is no such definition, or lacks a type.
    """

    def __init__(self, name: str, definition: str) -> None:
        self.name = name
        self.types = _types_of(_short(name), definition)
        self.root = _short(name)
        self._check(self.root, ())

    def decode(self, payload: bytes | memoryview) -> DecodedMessage:
        """Return the numbers of one message.

        Raises:
            WireFormatError: The payload is malformed; names its offset.
        """
        reader, found = _FieldReader(payload), DecodedMessage()
        self._take(reader, self.root, "", (), found)
        reader.end()
        return found

    def _check(self, kind: str, within: tuple[str, ...]) -> None:
        if kind in within or len(within) > DEEPEST:
            raise WireFormatError(f"the definition of {self.name} holds itself", 0)
        for own in self.types[kind]:
            if own.kind in CODES or own.kind == STRING:
                continue
            if own.kind not in self.types:
                raise WireFormatError(f"the definition of {self.name} lacks the type {own.kind}", 0)
            self._check(own.kind, (*within, kind))

    def _take(
        self,
        reader: _FieldReader,
        kind: str,
        path: str,
        labels: tuple[str, ...],
        found: DecodedMessage | None,
    ) -> None:
        for own in self.types[kind]:
            place = f"{path}.{own.name}" if path else own.name
            if own.kind == STRING:
                texts = reader.texts(own.many, place)
                if own.many is not None and own.name in LABELS:
                    labels = texts
                    if found is not None and not found.labels:
                        found.labels = texts
            elif own.kind in CODES:
                values = reader.values(CODES[own.kind], own.many, place)
                if found is not None and CODES[own.kind] in _FLOATS and place != "time":
                    found.values |= named(place, values, own.many, labels)
                    if len(found.values) > MOST:
                        raise WireFormatError(f"more than {MOST} numbers", reader.offset)
            elif own.many is not None:  # whose numbers have no joint of their own
                for _ in range(reader.length(own.many, place)):
                    self._take(reader, own.kind, place, labels, None)
            elif own.kind == HEADER and not path and found is not None:
                found.stamp_ns = reader.time(place)
                reader.string(place)
            else:
                kept = None if own.kind in _TIMES else found
                self._take(reader, own.kind, place, labels, kept)


class _FieldReader(CdrReader):
    """Takes fields of any primitive type off a message."""

    def values(self, code: str, many: int | None, name: str) -> tuple[float, ...]:
        """Take one number, or an array of them."""
        count = 1 if many is None else self.length(many, name)
        if not count:
            return ()
        packer = struct.Struct(f"{self._order}{count}{code}")
        return packer.unpack_from(
            self._data, self._take(packer.size, struct.calcsize(f"<{code}"), name)
        )

    def texts(self, many: int | None, name: str) -> tuple[str, ...]:
        """Take one string, or an array of them."""
        count = 1 if many is None else self.length(many, name)
        return tuple([self.string(name) for _ in range(count)])

    def length(self, many: int, name: str) -> int:
        """Take the length of an array, unless its type states it."""
        count = many or self.number("I", name)
        if count > MOST:
            raise WireFormatError(f"{name} has length {count}, expected {MOST} at most", 0)
        return count


@lru_cache(maxsize=64)
def layout_of(name: str, definition: bytes) -> MessageLayout | str:
    """Return the layout of a type, or why there is none, in words.

    Args:
        name: Of the type.
        definition: As the bag has it; empty where it has none.
    """
    if not definition:
        return (
            "the bag does not define it; `ros2 bag convert` to MCAP, on a machine that knows the "
            "type, does"
        )
    try:
        return MessageLayout(name, definition.decode())
    except (WireFormatError, UnicodeDecodeError) as error:
        return str(error)


def named(
    place: str, values: tuple[float, ...], many: int | None, labels: tuple[str, ...]
) -> Mapping[str, float]:
    """Return the numbers of a field by column.

    Args:
        place: Of the field, such as `feedback.positions`.
        values: Its numbers.
        many: None of a field that is no array.
        labels: Joints that the message names, which name as many numbers.
    """
    if many is None:
        return {place: values[0]}
    if labels and len(labels) == len(values):
        return {f"{place}.{label}": value for label, value in zip(labels, values, strict=True)}
    return {f"{place}[{k}]": value for k, value in enumerate(values)}


def _types_of(root: str, definition: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the fields of each type in a definition, by its name in two words."""
    found: dict[str, tuple[MessageField, ...]] = {}
    for part in re.split(r"^=+\s*$", definition, flags=re.MULTILINE):
        head, _, rest = part.strip().partition("\n")
        if head.startswith("MSG:"):
            name, text = _short(head.removeprefix("MSG:").strip()), rest
        elif not found:
            name, text = root, part
        else:
            raise WireFormatError(f"the definition of {root} is no ros2msg", 0)
        found[name] = tuple(_fields(text, name.split("/")[0]))
    return {name: tuple(_whole(item, found) for item in own) for name, own in found.items()}


def _fields(text: str, package: str) -> list[MessageField]:
    fields = list[MessageField]()
    for line in text.splitlines():
        bare = line.split("#", 1)[0].strip()
        if not bare:
            continue
        match = _FIELD.match(bare)
        if match is None:
            if re.match(r"^\w[\w/]*(<=\d+)?\s+[A-Z]\w*\s*=", bare):
                continue  # a constant, which is not in the message
            raise WireFormatError(f"{bare!r} is no field of a message", 0)
        if match["constant"]:
            continue
        kind = match["type"]
        if kind not in CODES and kind != STRING:
            kind = HEADER if kind == "Header" else _short(kind)
            kind = kind if "/" in kind else f"{package}/{kind}"
        size = match["size"] or ""
        many = None if match["array"] is None else int(size) if size.isdigit() else 0
        fields.append(MessageField(match["name"], kind, many))
    return fields


def _whole(own: MessageField, known: Mapping[str, object]) -> MessageField:
    """Return a field whose type is named as it is in the definition, whatever package says it."""
    if own.kind in known or own.kind in CODES or own.kind == STRING:
        return own
    last = own.kind.rpartition("/")[2]
    alike = [name for name in known if name.rpartition("/")[2] == last]
    return MessageField(own.name, alike[0], own.many) if len(alike) == 1 else own


def _short(name: str) -> str:
    """Return a type as `package/Type`."""
    return name.replace("/msg/", "/")


# The generated classes of protobuf are not typed, and which fields a message has, its schema knows.
JSON: Final = "json"
PROTOBUF: Final = "protobuf"
_SECONDS: Final = ("sec", "secs", "seconds")
_NANOSECONDS: Final = ("nanosec", "nsec", "nsecs", "nanos")
_STAMPS: Final = ("timestamp", "stamp", "time", "header.stamp", "header.timestamp")
_ID: Final = ("name", "joint_name", "joint", "id")  # of one of several alike
_NANO: Final = 1_000_000_000


def numbers_of(message: LoggedMessage) -> DecodedMessage:
    """Return the numbers of a message in JSON or protobuf.

    Names are those of its fields, `state.q[3]`; of lists that have a list of names, and of objects
    that have one, the name stands in the place of the number: `position.elbow`.

    Raises:
        WireFormatError: It is malformed, or has more numbers or levels than a message of joints.
    """
    try:
        if message.encoding == JSON:
            tree = json.loads(message.payload)
        else:
            tree = _tree(_class_of(message.schema, message.definition).FromString(message.payload))
    except (ValueError, TypeError, KeyError, RecursionError, RuntimeError) as error:
        why = " ".join(str(error).split())
        raise WireFormatError(f"{message.encoding} that cannot be read: {why}", 0) from None
    except Exception as error:
        if type(error).__module__.startswith("google."):
            raise WireFormatError(f"protobuf that cannot be read: {error}", 0) from None
        raise
    found = DecodedMessage()
    if isinstance(tree, dict):
        _take(cast("dict[str, Any]", tree), "", found, 0)
    return found


@lru_cache(maxsize=64)
def _class_of(name: str, definition: bytes) -> Any:  # noqa: ANN401  # a class of protobuf's
    """Return the class of a type, of descriptors of its files in any order."""
    pool = DescriptorPool()
    waiting = {file.name: file for file in FileDescriptorSet.FromString(definition).file}

    def add(file: Any) -> None:  # noqa: ANN401
        for other in file.dependency:
            if other in waiting:
                add(waiting.pop(other))
        pool.Add(file)

    while waiting:
        add(waiting.popitem()[1])
    return GetMessageClass(pool.FindMessageTypeByName(name))


def _tree(message: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the fields of a message of protobuf, also those that are 0."""
    found: dict[str, Any] = {}
    for own in message.DESCRIPTOR.fields:
        value = getattr(message, own.name)
        if own.message_type is None:
            is_one = isinstance(value, (int, float, str, bytes, bool))
            found[own.name] = value if is_one else list(value)
        elif own.message_type.GetOptions().map_entry:
            found[own.name] = {str(key): value[key] for key in value if _is_number(value[key])}
        elif hasattr(value, "DESCRIPTOR"):
            found[own.name] = _tree(value) if message.HasField(own.name) else {}
        else:
            found[own.name] = [_tree(each) for each in value]
    return found


def _take(tree: Mapping[str, Any], path: str, found: DecodedMessage, depth: int) -> None:
    if depth > DEEPEST:
        raise WireFormatError(f"nested deeper than {DEEPEST} levels", 0)
    labels = next((tuple(tree[key]) for key in LABELS if _are_texts(tree.get(key))), ())
    found.labels = found.labels or labels
    for key, value in tree.items():
        place = f"{path}.{key}" if path else key
        if _is_number(value):
            found.values[place] = _number(value)
        elif isinstance(value, dict):
            stamp = _stamp_of(cast("dict[str, Any]", value))
            if stamp is None:
                _take(cast("dict[str, Any]", value), place, found, depth + 1)
            elif place in _STAMPS:
                found.stamp_ns = stamp
        elif isinstance(value, list):
            _take_list(cast("list[Any]", value), place, labels, found)
        if len(found.values) > MOST:
            raise WireFormatError(f"more than {MOST} numbers", 0)


def _take_list(
    values: list[Any], place: str, labels: tuple[str, ...], found: DecodedMessage
) -> None:
    if values and len(values) <= MOST and all(map(_is_number, values)):
        found.values.update(named(place, tuple(map(_number, values)), 0, labels))
        return
    around = place.rpartition(".")[0]
    for each in values if all(isinstance(each, dict) for each in values) else ():
        label = next((each[key] for key in _ID if isinstance(each.get(key), str)), None)
        if label is not None:
            found.labels = (*found.labels, label)
            more = {f"{around}.{x}" if around else x: y for x, y in each.items() if _is_number(y)}
            found.values |= {f"{name}.{label}": _number(value) for name, value in more.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _number(value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        raise WireFormatError("a number of hundreds of digits", 0) from None


def _are_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(x, str) for x in cast("list[object]", value))


def _stamp_of(value: Mapping[str, Any]) -> int | None:
    """Return a time [ns] that an object is; None if it is another."""
    seconds = next((value[key] for key in _SECONDS if key in value), None)
    more = next((value[key] for key in _NANOSECONDS if key in value), None)
    if len(value) != 2 or not isinstance(seconds, int) or not isinstance(more, int):  # noqa: PLR2004
        return None
    return seconds * _NANO + more
