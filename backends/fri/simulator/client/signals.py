"""IOs and transformations that the application of the simulated controller names."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from backends.fri.codec.messages import (
    MAX_IO,
    MAX_NAME,
    MAX_TRANSFORMATIONS,
    IoDirection,
    IoType,
    IoValue,
    Transformation,
)
from backends.fri.codec.version import Generation
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from backends.fri.codec.messages import CommandData

_TYPES: Final = {"bool": IoType.BOOLEAN, "digital": IoType.DIGITAL, "analog": IoType.ANALOG}
_DIRECTIONS: Final = {"input": IoDirection.INPUT, "output": IoDirection.OUTPUT}
_EXPECTED: Final = (
    "NAME:TYPE:DIRECTION or NAME:TYPE:DIRECTION:VALUE, of bool, digital or analog and of input or "
    "output"
)
_IDENTITY_MATRIX: Final = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_IDENTITY_POSE: Final = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def parse_io(text: str) -> IoValue:
    """Read an IO, for example `FRI.Clock:bool:input:1`; without a value it is 0.

    Raises:
        ConfigError: Something else.
    """
    name, *rest = text.split(":")
    if not 2 <= len(rest) <= 3 or rest[0] not in _TYPES or rest[1] not in _DIRECTIONS:  # noqa: PLR2004
        raise ConfigError(f"IO {text!r} has to be {_EXPECTED}")
    kind, direction = _TYPES[rest[0]], _DIRECTIONS[rest[1]]
    check_signal_name(name)
    number = rest[2] if len(rest) > 2 else "0"  # noqa: PLR2004
    try:
        if kind is IoType.ANALOG:
            if not math.isfinite(analog := float(number)):
                raise ValueError
            return IoValue(name, kind, direction, analog=analog)
        most = 1 if kind is IoType.BOOLEAN else (1 << 64) - 1
        if not 0 <= int(number) <= most:
            raise ValueError
        return IoValue(name, kind, direction, digital=int(number))
    except ValueError:
        raise ConfigError(f"IO {text!r}: {number!r} is no value of a {rest[0]} IO") from None


def check_signal_name(name: str) -> None:
    """Refuse a name that the wire cannot carry.

    Raises:
        ConfigError: None, or one that is too long.
    """
    if not 0 < len(name.encode()) <= MAX_NAME:
        raise ConfigError(f"{name!r} is no name of an IO or a frame: 1 to {MAX_NAME} bytes")


class Signals:
    """Values of what the application names, as the client last set them.

    Args:
        ios: Inputs, and outputs with their first values.
        frames: Names of the transformations that are requested.

    Raises:
        ConfigError: More than a message holds, or one name twice.
    """

    def __init__(self, ios: tuple[IoValue, ...] = (), frames: tuple[str, ...] = ()) -> None:
        for names, most, what in (
            ([io.name for io in ios], MAX_IO, "IOs"),
            (list(frames), MAX_TRANSFORMATIONS, "transformations"),
        ):
            if len(names) > most or len(set(names)) < len(names):
                raise ConfigError(
                    f"{', '.join(names)}: at most {most} {what} can be named, each once"
                )
        self._ios = {io.name: io for io in ios}
        self._frames: dict[str, Transformation | None] = dict.fromkeys(frames)

    @property
    def ios(self) -> tuple[IoValue, ...]:
        """All IOs with their values."""
        return tuple(self._ios.values())

    def requested(self, generation: Generation) -> tuple[Transformation, ...]:
        """Return the transformations that are asked for, as a monitoring message names them."""
        at = _IDENTITY_MATRIX if generation is Generation.ONE else _IDENTITY_POSE
        return tuple(Transformation(name, at) for name in self._frames)

    def take(self, data: CommandData | None) -> Iterator[str]:
        """Take what a client sets; say what it may not."""
        if data is None:
            return
        for io in data.io:
            known = self._ios.get(io.name)
            if known is None:
                yield f"sets the IO {io.name!r}, which the application does not name"
            elif known.direction is IoDirection.INPUT:
                yield f"sets {io.name!r}, which is an input"
            elif known.type is not io.type or io.value is None:
                given, kind = io.type.name.lower(), known.type.name.lower()
                yield f"sets {io.name!r} as {given}, but it is {kind}"
            elif isinstance(io.value, float) and not math.isfinite(io.value):
                yield f"sets {io.name!r} to {io.value}"
            else:
                self._ios[io.name] = replace(known, digital=io.digital, analog=io.analog)
        for frame in data.transformations:
            if frame.name not in self._frames:
                yield f"sends the transformation {frame.name!r}, which was not requested"
            elif not all(map(math.isfinite, frame.elements)):
                yield f"sends the transformation {frame.name!r}, which is not finite"
            else:
                self._frames[frame.name] = frame

    def as_json(self) -> dict[str, Any]:
        """Return plain values: of each IO, and of each transformation what came last."""
        return {
            "ios": {io.name: io.value for io in self._ios.values()},
            "transformations": {
                name: None if frame is None else list(frame.elements)
                for name, frame in self._frames.items()
            },
        }
