"""Check the commands of a client against the limits of the simulated controller.

The limits are limo's model: KUKA's own 'illegal axis delta' stands in its manual only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from backends.fri.codec.codec import decode_command
from backends.fri.codec.messages import (
    JOINTS,
    MAX_IO,
    MAX_NAME,
    MAX_TRANSFORMATIONS,
    WRENCH,
    CommandMode,
    Generation,
    IoDirection,
    IoType,
    IoValue,
    Transformation,
)
from limo_driver.errors import ConfigError, WireFormatError
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from backends.fri.codec.messages import Command, CommandData, FriVersion
    from limo_driver.types import FloatArray, JointLimits

ROUNDING: Final = 2e-6  # relative: the difference of two positions has few digits of either
MOST_INTERVALS: Final = 10  # that a step may have had time for, after answers were lost
_TYPES: Final = {"bool": IoType.BOOLEAN, "digital": IoType.DIGITAL, "analog": IoType.ANALOG}
_DIRECTIONS: Final = {"input": IoDirection.INPUT, "output": IoDirection.OUTPUT}
_EXPECTED: Final = (
    "NAME:TYPE:DIRECTION or NAME:TYPE:DIRECTION:VALUE, of bool, digital or analog and of input or "
    "output"
)
_IDENTITY_MATRIX: Final = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
_IDENTITY_POSE: Final = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def _limit(unit: str, description: str, default: float):  # noqa: ANN202  # a dataclass field
    return parameter(unit, description, lower=0, above=True, finite=False, default=default)


@dataclass(frozen=True)
class CommandLimits(Declared):
    """Limits of a command (limo's model)."""

    axis_delta: float = _limit("", "times the velocity limit, from one command to the next", 1.0)
    mirror: float = _limit("rad", "distance from the ipo position that confirms it", 0.01)
    torque: float = _limit("", "times the torque limit", 1.0)
    force: float = _limit("N", "each component of a wrench", 200.0)
    moment: float = _limit("N m", "each component of a wrench", 50.0)


class Wanted(NamedTuple):
    """Set-point that a command asks for."""

    position: FloatArray | None = None  # (7,) [rad]
    torque: FloatArray | None = None  # (7,) [N m]
    wrench: FloatArray | None = None  # (6,) [N, N m]


class CommandJudge:
    """Judges the commands of one session.

    Args:
        mode: What the application lets the client command.
        joints: Limits of the arm.
        limits: What a command may ask for.
        interval: From one command to the next [s].
    """

    def __init__(
        self, mode: CommandMode, joints: JointLimits, limits: CommandLimits, interval: float
    ) -> None:
        self.mode, self.limits, self.joints = mode, limits, joints
        self._step = limits.axis_delta * joints.velocity * interval
        self._torque = limits.torque * joints.torque
        self._wrench = np.array([limits.force] * 3 + [limits.moment] * 3)

    def read(self, data: CommandData | None) -> tuple[Wanted, str]:
        """Return the set-point of a command, and why it is ignored; empty if it is not."""
        if data is None:
            return Wanted(), "a command without data while the arm is to be commanded"
        parts = {
            "position": (data.joint_position, JOINTS),
            "torque": (data.joint_torque, JOINTS),
            "wrench": (data.wrench, WRENCH),
        }
        read: dict[str, FloatArray] = {}
        for name, (values, size) in parts.items():
            if values is None:
                continue
            if len(values) != size:
                return Wanted(), f"{name} has {len(values)} values, expected {size}"
            array = np.array(values)
            if not np.isfinite(array).all():
                return Wanted(), f"{name} is not finite"
            read[name] = array
        wanted = Wanted(**read)
        return wanted, self._missing(wanted)

    def confirms(self, wanted: Wanted, ipo: FloatArray) -> str:
        """Say why a command does not confirm the set-point in COMMANDING_WAIT; empty if it does."""
        if wanted.position is None:
            return ""  # of torque or wrench alone; `read` saw that they are there
        off = np.abs(wanted.position - ipo)
        if (off <= self.limits.mirror).all():
            return ""
        j = int(np.argmax(off))
        return (
            f"in COMMANDING_WAIT joint {j + 1} has to mirror the ipo position; it is off by more "
            f"than {self.limits.mirror:g} rad"
        )

    def share_of_step(self, wanted: Wanted, before: FloatArray, intervals: int) -> float:
        """Return how far a command goes, as a share of what a joint may in that time."""
        if wanted.position is None:
            return 0.0
        return float((np.abs(wanted.position - before) / self._most_step(intervals)).max())

    def stops(self, wanted: Wanted, before: FloatArray, intervals: int) -> str:
        """Say why the arm has to stop for a command; empty if it need not.

        Args:
            wanted: The command.
            before: Position commanded before, (7,) [rad].
            intervals: Receive intervals since then.
        """
        if wanted.position is not None:
            step = self._most_step(intervals)
            delta = np.abs(wanted.position - before)
            if (delta > step * (1.0 + ROUNDING)).any():
                j = int(np.argmax(delta / step))
                return (
                    f"illegal axis delta: joint {j + 1} is told to jump by {delta[j]:.4g} rad, "
                    f"at most {step[j]:.4g} rad"
                )
            low, high = self.joints.position_min, self.joints.position_max
            for j in np.flatnonzero((wanted.position < low) | (wanted.position > high)):
                return (
                    f"joint {j + 1} is told to go to {wanted.position[j]:.4g} rad, outside "
                    f"{low[j]:.4g} to {high[j]:.4g} rad"
                )
        for values, most, what, unit in (
            (wanted.torque, self._torque, "joint", "N m"),
            (wanted.wrench, self._wrench, "wrench component", "N or N m"),
        ):
            if values is not None and (np.abs(values) > most).any():
                j = int(np.argmax(np.abs(values) / most))
                return f"{what} {j + 1} is told {values[j]:.4g} {unit}, at most {most[j]:.4g}"
        return ""

    def _most_step(self, intervals: int) -> FloatArray:
        return self._step * min(max(intervals, 1), MOST_INTERVALS)

    def _missing(self, wanted: Wanted) -> str:
        """Say which part a command lacks for the mode, or has without any use."""
        needed = {
            CommandMode.POSITION: wanted.position,
            CommandMode.TORQUE: wanted.torque,
            CommandMode.WRENCH: wanted.wrench,
        }
        mode = self.mode.name.lower()
        if self.mode in needed and needed[self.mode] is None:
            return f"a command without {mode} in {mode} mode"
        for other, values in needed.items():
            extra = other not in {self.mode, CommandMode.POSITION} and values is not None
            if extra and values is not None and values.any():
                return f"a command with {other.name.lower()} in {mode} mode"
        return ""


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
                self._ios[io.name] = known._replace(digital=io.digital, analog=io.analog)
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


def display_name(data: bytes, version: FriVersion) -> str:
    """Say whose command a datagram is that is none of this version; empty if nobody's."""
    for generation in Generation:
        if generation is version.generation:
            continue
        try:
            decode_command(data, generation)
        except WireFormatError:
            continue
        framing = "framed" if generation.framed else "not framed"
        return _fault(f"is {framing}, as those of FRI {generation.value}", version)
    return ""


def monitored_as_of(command: Command, version: FriVersion) -> str:
    """Say for which version a client was built that answers so while it is monitored.

    Clients of 1.x send back the commanded position; later ones send the header alone.
    """
    mirrors = command.data is not None and command.data.joint_position is not None
    if version.generation is Generation.ONE:
        return "" if mirrors else _fault("has no position, as those of FRI 2.5 and later", version)
    return _fault("has a position, as those of FRI 1.x", version) if mirrors else ""


def _fault(what: str, version: FriVersion) -> str:
    return (
        f"version mismatch: an answer {what}, but this controller speaks {version.value}: "
        "build the client for that, or choose --fri"
    )
