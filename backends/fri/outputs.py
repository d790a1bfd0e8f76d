"""Outputs that a user sets, repeated until the robot has received them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.codec.messages import MAX_IO, IoDirection, IoType, IoValue
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

_DIGITAL: Final = 1 << 64
_HALF: Final = 1 << 31


class Outputs:
    """Values on their way to the robot; each stays until an answer with it was received."""

    def __init__(self) -> None:
        self._values: dict[str, IoValue] = {}
        self._since: dict[str, int] = {}  # sequence of the first answer with the value

    @property
    def waiting(self) -> tuple[IoValue, ...]:
        """What the next answer has to say; what does not fit waits for its turn."""
        return tuple(self._values.values())[:MAX_IO] if self._values else ()

    def set(self, name: str, value: float | bool, known: Sequence[IoValue]) -> None:
        """Take a value for an output that the robot's application named.

        Raises:
            ConfigError: No such output, or a value of another type.
        """
        found = next((io for io in known if io.name == name), None)
        if found is None:
            names = ", ".join(io.name for io in known) or "none"
            raise ConfigError(f"the robot's application names no IO {name!r}; it names: {names}")
        if found.direction is not IoDirection.OUTPUT:
            raise ConfigError(f"{name} is an input; only outputs can be set")
        self._values[name] = _valued(found, value)
        self._since.pop(name, None)

    def note_sent(self, sequence: int) -> None:
        """Note the sequence of an answer that carried what was waiting."""
        for io in self.waiting if self._values else ():
            # A robot that has received nothing reflects 0, too: the first answer confirms nothing.
            self._since.setdefault(io.name, max(sequence, 1))

    def note_received(self, sequence: int) -> None:
        """Note the last answer that the robot received."""
        if not self._since:
            return
        for name, since in list(self._since.items()):
            if (sequence - since) % (2 * _HALF) < _HALF:
                del self._since[name], self._values[name]


def _valued(io: IoValue, value: float | bool) -> IoValue:
    """Return the output with a value of its type."""
    if io.type is IoType.ANALOG:
        if isinstance(value, bool) or not _finite(value):
            raise ConfigError(f"{io.name} is analog, but {value!r} was given")
        return IoValue(io.name, io.type, io.direction, analog=float(value))
    if io.type is IoType.BOOLEAN:
        if value not in (0, 1):
            raise ConfigError(f"{io.name} is a boolean, but {value!r} was given")
        return IoValue(io.name, io.type, io.direction, digital=int(value))
    if isinstance(value, bool) or not _finite(value) or value % 1 or not 0 <= value < _DIGITAL:
        raise ConfigError(f"{io.name} is an integer of 64 bits, but {value!r} was given")
    return IoValue(io.name, io.type, io.direction, digital=int(value))


def _finite(value: object) -> bool:
    try:
        return isinstance(value, (int, float, np.number)) and math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False
