"""Messages of MCAP files in JSON and protobuf, as Foxglove's SDKs write them: numbers by name.

Protobuf's schemas are descriptors, and protobuf itself reads messages by them; no code is made.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, cast

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from limo_driver.errors import WireFormatError
from limo_driver.logs.ros.message_layout import DEEPEST, LABELS, MOST, DecodedMessage, named

if TYPE_CHECKING:
    from collections.abc import Mapping

    from limo_driver.logs.mcap_file import LoggedMessage

# The generated classes of protobuf are not typed, and which fields a message has, its schema knows.
# pyright: reportUnknownParameterType=false
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
