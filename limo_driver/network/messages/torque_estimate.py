"""What a service says on the wire: estimates of torque, wrenches, and events.

Events are rcl_interfaces/msg/Log in CDR, so that whatever shows a ROS log shows them too. The field
`name` holds the kind of event and `msg` a JSON object `{"text": ..., "facts": {...}}`. Wrenches go
with their covariance, for which ROS 2 has no message of its own.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import lru_cache
from typing import Any, Final, cast

import numpy as np

from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.network.messages.cdr import (
    HEADER_SIZE,
    CdrReader,
    CdrWriter,
    RobotCodec,
    check_lengths,
    padding,
    split_time,
    utf8,
)
from limo_driver.types import BoolArray, FloatArray

_STAMP: Final = struct.Struct("<iI")
_GAP_SIZE: Final = 3  # bytes; readers of before took so many for padding
_LONGEST_GAP: Final = 2 ** (8 * _GAP_SIZE) - 1  # [ms]


def encode_wrench(stamp_ns: int, frame_id: str, wrench: FloatArray) -> bytes:
    """Return a WrenchStamped.

    Args:
        stamp_ns: Time of the wrench [ns].
        frame_id: In whose axes, and about whose origin, it is.
        wrench: Force, then torque, (6,) [N, N m].
    """
    writer = CdrWriter()
    writer.time(stamp_ns)
    writer.string(frame_id)
    writer.doubles(wrench)
    return bytes(writer.data)


def encode_matrix(label: str, matrix: FloatArray) -> bytes:
    """Return a Float64MultiArray of two dimensions.

    Args:
        label: Of both of them.
        matrix: (r, c), which goes row by row.
    """
    rows, columns = matrix.shape
    writer = CdrWriter()
    writer.number("I", matrix.ndim)
    for size, stride in ((rows, rows * columns), (columns, columns)):
        writer.string(label)
        writer.number("I", size)
        writer.number("I", stride)
    writer.number("I", 0)  # offset of the data
    writer.number("I", matrix.size)
    writer.doubles(matrix)
    return bytes(writer.data)


@dataclass(frozen=True)
class TorqueEstimate:
    """An estimate as it came off the wire; arrays have one value for each name, or none."""

    stamp_ns: int  # of the joint state that it answers
    frame_id: str
    names: tuple[str, ...]
    torque: FloatArray  # (n,) or (0,) [N m], estimated
    std: FloatArray  # (n,) or (0,) [N m], one standard deviation
    external: FloatArray  # (n,) or (0,) [N m], measured minus estimated
    outside: BoolArray  # (n,) or (0,), motion unlike what was learned
    model: str  # its version
    fallback: bool  # the estimate is of the physics alone
    reset: bool  # the memory of the estimator started anew at this sample
    since_gap: float  # stream's time since memory last began anew [s]; NaN of who does not tell


class TorqueEstimateCodec(RobotCodec):
    """Encodes estimates for one robot; what does not change is encoded once.

    Args:
        names: Joints, in the order of the arrays.
        frame_id: Of the header.
    """

    def __init__(self, names: Sequence[str], frame_id: str = "") -> None:
        super().__init__(names, frame_id, "ddd?")

    def encode(
        self,
        stamp_ns: int,
        torque: FloatArray,
        std: FloatArray,
        external: FloatArray,
        outside: BoolArray,
        *,
        model: str = "",
        fallback: bool = False,
        reset: bool = False,
        since_gap: float = math.nan,
    ) -> bytes:
        """Return the message.

        Args:
            stamp_ns: Time of the joint state that is answered [ns].
            torque: Estimated torques, shape (n,), or (0,) where unknown [N m].
            std: Standard deviations, likewise [N m].
            external: Measured minus estimated torques, likewise [N m].
            outside: Whether the motion is unlike what was learned, likewise.
            model: Version of the model.
            fallback: The estimate is of the physics alone.
            reset: The memory of the estimator started anew at this sample.
            since_gap: Stream's time since memory last began anew [s]; NaN where unknown.

        Raises:
            ShapeError: An array has another shape.
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        body = self._packed(stamp_ns, torque=torque, std=std, external=external, outside=outside)
        return body + _tail(len(body), model, fallback, reset) + _milliseconds(since_gap)


class EstimateDraft:
    """Message of one version of a model, whose arrays are written where they stand in it.

    Args:
        codec: Of the robot.
        model: Version of the model.
        fallback: The estimates are of the physics alone.
    """

    def __init__(self, codec: TorqueEstimateCodec, model: str, *, fallback: bool) -> None:
        n = len(codec.names)
        nothing, nowhere = np.full(n, np.nan), np.zeros(n, np.bool_)
        message = codec.encode(
            0, nothing, nothing, nothing, nowhere, model=model, fallback=fallback
        )
        # a header ahead, so that what is aligned behind the message's own is so in memory
        values = np.empty(HEADER_SIZE + len(message), np.uint8)[HEADER_SIZE:]
        values[:] = np.frombuffer(message, np.uint8)
        self._message = values.data
        first = codec.start + padding(codec.start, 4) + 4
        places = first + padding(first, 8) + (8 * n + 8) * np.arange(3)  # a length between two
        self.torque, self.std, self.external = (
            values[at : at + 8 * n].view(np.float64) for at in places
        )  # (n,) each [N m]
        at = places[2] + 8 * n + 4
        self.outside = values[at : at + n].view(np.bool_)  # (n,)

    def finished(self, stamp_ns: int, *, reset: bool, since_gap: float) -> bytes:
        """Return the message of a stamp, as `TorqueEstimateCodec.encode` does.

        Raises:
            WireFormatError: The stamp does not fit into 32 bits of seconds.
        """
        _STAMP.pack_into(self._message, HEADER_SIZE, *split_time(stamp_ns))
        self._message[-_GAP_SIZE - 1] = reset
        self._message[-_GAP_SIZE:] = _milliseconds(since_gap)
        return self._message.tobytes()


def decode_torque_estimate(payload: bytes | memoryview) -> TorqueEstimate:
    """Return the estimate that a payload holds, of either byte order.

    Raises:
        WireFormatError: The payload is malformed; names its offset.
    """
    reader = CdrReader(payload)
    estimate = TorqueEstimate(
        reader.time("stamp"),
        reader.string("frame_id"),
        reader.strings("name"),
        reader.doubles("torque"),
        reader.doubles("std"),
        reader.doubles("external"),
        reader.flags("outside"),
        reader.string("model"),
        reader.flag("fallback"),
        reader.flag("reset"),
        1e-3 * int.from_bytes(reader.later(_GAP_SIZE), "little") or math.nan,
    )
    reader.end()
    check_lengths(
        reader.offset,
        name=len(estimate.names),
        torque=estimate.torque.size,
        std=estimate.std.size,
        external=estimate.external.size,
        outside=estimate.outside.size,
    )
    return estimate


def _milliseconds(since_gap: float) -> bytes:
    """Return a time [s] as whole milliseconds, from 1 to 4.6 hours; 0 where unknown."""
    if math.isnan(since_gap):
        return bytes(_GAP_SIZE)
    count = min(max(round(1e3 * since_gap), 1), _LONGEST_GAP)
    return count.to_bytes(_GAP_SIZE, "little")


@lru_cache(maxsize=64)
def _tail(offset: int, model: str, fallback: bool, reset: bool) -> bytes:
    """Return the fields after the arrays, which begin at `offset`; they seldom change."""
    encoded = utf8(model) + b"\x00"
    before = padding(offset, 4)
    return struct.pack(f"<{before}xI{len(encoded)}s??", len(encoded), encoded, fallback, reset)


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
    value = reader.number("B", "level")
    if value not in set(Level):
        known = ", ".join(str(int(level)) for level in Level)
        raise WireFormatError(f"level is {value}, expected one of {known}", reader.offset - 1)
    level = Level(value)
    kind = reader.string("name")
    text, facts = _message(reader)
    file, function = reader.string("file"), reader.string("function")
    line = reader.number("I", "line")
    reader.end()
    return Event(stamp_ns, level, kind, text, facts, file, function, line)


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
