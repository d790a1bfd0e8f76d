"""Events as rcl_interfaces/msg/Log in CDR, so that whatever shows a ROS log shows them too.

The field `name` holds the kind of event and `msg` a JSON object `{"text": ..., "facts": {...}}`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TYPE_CHECKING, Any, cast

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages.cdr import CdrReader, CdrWriter

if TYPE_CHECKING:
    from collections.abc import Mapping


class Level(IntEnum):
    """Severity of an event, with the numbers of ROS."""

    DEBUG = 10
    INFO = 20
    WARN = 30
    ERROR = 40
    FATAL = 50


@dataclass(frozen=True)
class Event:
    """Something that happened, for people and programs."""

    stamp_ns: int  # Unix time
    level: Level
    kind: str  # "contact", "drift", "swap", "log", ...
    text: str  # one sentence
    facts: Mapping[str, Any] = field(default_factory=dict)  # what JSON can hold
    file: str = ""  # where in the source it was told
    function: str = ""
    line: int = 0

    def encode(self) -> bytes:
        """Return the message.

        Raises:
            ConfigError: JSON cannot hold the facts.
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        try:
            message = _as_json({"text": self.text, "facts": dict(self.facts)})
        except (TypeError, ValueError, RecursionError) as error:
            raise ConfigError(
                f"facts of event {self.kind!r} cannot be written as JSON: {error}"
            ) from None
        writer = CdrWriter()
        writer.time(self.stamp_ns)
        writer.number("B", self.level)
        for text in (self.kind, message, self.file, self.function):
            writer.string(text)
        writer.number("I", self.line)
        return bytes(writer.data)


def decode_event(payload: bytes | memoryview) -> Event:
    """Return the event that a payload holds, of either byte order.

    Raises:
        WireFormatError: The payload is malformed, or a log message that is no event of limo's.
    """
    reader = CdrReader(payload)
    stamp_ns = reader.time("stamp")
    level = _level(reader)
    kind = reader.string("name")
    text, facts = _message(reader)
    file, function = reader.string("file"), reader.string("function")
    line = reader.number("I", "line")
    reader.end()
    return Event(stamp_ns, level, kind, text, facts, file, function, line)


def _level(reader: CdrReader) -> Level:
    value = reader.number("B", "level")
    if value not in set(Level):
        known = ", ".join(str(int(level)) for level in Level)
        raise WireFormatError(f"level is {value}, expected one of {known}", reader.offset - 1)
    return Level(value)


def _message(reader: CdrReader) -> tuple[str, dict[str, Any]]:
    at, encoded = reader.offset, reader.string("msg")
    try:
        message: object = json.loads(encoded)
        _as_json(message)
    except (ValueError, RecursionError):
        message = None
    match message:
        case {"text": str(text), "facts": dict(facts)}:
            return text, cast("dict[str, Any]", facts)
        case _:
            raise WireFormatError("msg is no JSON object with text and facts", at)


def _as_json(message: object) -> str:
    """Return a message as JSON; a ValueError where it holds NaN, infinity or half a character."""
    text = json.dumps(message, allow_nan=False, ensure_ascii=False)
    text.encode()
    return text
