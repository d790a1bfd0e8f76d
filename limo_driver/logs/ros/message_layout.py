"""What messages of any ROS 2 type hold, by the definition that a bag carries with them.

Numbers become named columns: `feedback.positions` of a message whose `joint_names` are `a, b` is
`feedback.positions.a` and `feedback.positions.b`; an array without names is `q[0]`, `q[1]`, ...
Definitions are parsed here and interpreted, so that no code is made of what a stranger's file says.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Final

from limo_driver.errors import WireFormatError
from limo_driver.network.messages.cdr import CdrReader

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
