"""What a file of a recording has: channels, columns and time, and angles without jumps."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.types import BoolArray, FloatArray

_TURN = 2 * np.pi
_OF_SPAN = 0.9  # of all that is recorded, that a wrap crosses at least
_OF_WRAP = 0.1  # of a wrap, that the joint moves in a sample beside it at most
_LEAST = 0.5  # [rad]; a smaller leap is a fault
_ALIKE = 0.01  # of a wrap, by which wraps of one joint differ
_BESIDE = 3  # samples before and after, whose median step is the joint's own motion
_FEWEST = 2  # wraps by another angle than a turn; one alone could be a slip
BEYOND: Final = 1e100  # of any unit, what nothing measures; squared it still is a number
RATES: Final = (9.0, 5500.0)  # [Hz], 10 Hz to 5 kHz with a tenth of margin
_PER_SECOND: Final = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}
_SINCE: Final = "taken as seconds since the first row"
_TAKEN: Final = ("microseconds", "nanoseconds")  # small steps of whole numbers could count rows


@dataclass(frozen=True)
class CommandChannel:
    """One kind of command: the name of its columns, without the joint, and its unit.

    Where a joint goes by commands that are no positions drifts from where the recorded one went.
    """

    name: str
    unit: str
    drifts: bool = True


POSITION: Final = CommandChannel("command", "rad", drifts=False)
VELOCITY: Final = CommandChannel("command_velocity", "rad/s")
TORQUE: Final = CommandChannel("command_torque", "N m")
CHANNELS: Final = {channel.name: channel for channel in (POSITION, VELOCITY, TORQUE)}


def channels_of(given: tuple[str, ...], n: int) -> tuple[str, ...]:
    """Return the channel of each joint, (n,): positions, where nothing is said.

    Args:
        given: By joint, or none.
        n: Number of joints.

    Raises:
        ShapeError: There are fewer or more of them.
        RecordingError: There is no such channel.
    """
    found = tuple(given) or (POSITION.name,) * n
    if len(found) != n:
        raise ShapeError("channels", (len(found),), f"({n},)")
    if unknown := [name for name in found if name not in CHANNELS]:
        raise RecordingError(f"channel is {unknown[0]!r}, expected one of {', '.join(CHANNELS)}")
    return found


def commanded_by(channel: CommandChannel, channels: Sequence[str]) -> BoolArray:
    """Say which joints are told by a channel, (n,).

    Args:
        channel: The channel.
        channels: Name of that of each joint.
    """
    return np.array([name == channel.name for name in channels])


def drifting(channels: Sequence[str | None]) -> list[int]:
    """Return the joints that are told what is no position, 1-based.

    Args:
        channels: Name of that of each joint; None where it has none.
    """
    every = enumerate(channels, start=1)
    return [j for j, name in every if name is not None and CHANNELS[name].drifts]


def by_channel(command: FloatArray, channels: Sequence[str]) -> dict[str, FloatArray]:
    """Return commands (T, n) by the channel of their joints; 0 at all others.

    Args:
        command: (T, n), in the unit of each joint's channel.
        channels: Name of the channel of each joint.
    """
    own = {name: commanded_by(CHANNELS[name], channels) for name in dict.fromkeys(channels)}
    return {name: np.where(joints, command, 0.0) for name, joints in own.items()}


def recorded_channel(joint: int, columns: Collection[str]) -> str | None:
    """Return the channel of a joint's command among columns: that of positions first.

    Args:
        joint: 1-based.
        columns: Names of all columns.
    """
    return next((name for name in CHANNELS if f"{name}_{joint}" in columns), None)


def chosen(
    command: FloatArray | None,
    channels: Sequence[str],
    others: Mapping[str, FloatArray],
    wanted: Sequence[str | None],
    source: str = "",
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return the commands that drives take (T, n), and the channel of each joint.

    Args:
        command: As recorded, (T, n); None where there is none but among the others.
        channels: Name of the channel of each joint there.
        others: What else was recorded of each joint, by name, (T, n) each.
        wanted: Name of the channel of each joint's drive; None where any will do.
        source: Of the recording, for messages.

    Raises:
        RecordingError: What a drive takes was not recorded, or not in all rows; names the column.
    """
    if command is not None and all(
        own in {None, has} for own, has in zip(wanted, channels, strict=True)
    ):
        return command, tuple(channels)
    values, names = list[FloatArray](), list[str]()
    for j, (own, has) in enumerate(zip(wanted, channels, strict=True)):
        known = {name: others[name][:, j] for name in CHANNELS if name in others}
        if command is not None:
            known = {has: command[:, j], **known}
        known = {name: each for name, each in known.items() if np.isfinite(each).any()}
        name = next(iter(known), None) if own is None else own
        if name is None or name not in known:
            raise RecordingError(_lacking(name or POSITION.name, j + 1, known), path=source or None)
        if missing := int((~np.isfinite(known[name])).sum()):
            raise RecordingError(
                f"{name}_{j + 1} is no number in {missing} rows; leave these rows out",
                path=source or None,
            )
        values.append(known[name])
        names.append(name)
    return np.stack(values, axis=1), tuple(names)


def _lacking(name: str, joint: int, known: Collection[str]) -> str:
    text = f"lacks {name}_{joint}: the drive of joint {joint} takes {CHANNELS[name].unit}"
    has = [f"{other}_{joint} [{CHANNELS[other].unit}]" for other in known]
    return f"{text}, and what was recorded is {', '.join(has)}" if has else text


@dataclass(frozen=True)
class Columns:
    """Content of a file, before its rows are checked."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray  # (T, n) [N m]
    velocity: FloatArray | None = None  # (T, n) [rad/s]
    extras: dict[str, FloatArray] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    robot: str = ""  # as the file names it, if it does
    torque_resolution: FloatArray | None = None  # (n,) [N m], where the file tells it
    command: FloatArray | None = None  # (T, n), in force at each row, as the joint's channel has it
    channels: tuple[str, ...] = ()  # of the commands, by joint; set-points of positions, if empty
    spread: int = 0  # rows of the log of which these are evenly spread stretches; 0 if they are all

    @property
    def led(self) -> tuple[str, ...]:
        """Channel of each joint's command."""
        return channels_of(self.channels, self.position.shape[1])

    def quantities(self) -> dict[str, FloatArray]:
        """Return all that was measured or commanded of the joints, by name, (T, n) each."""
        measured = {"position": self.position, "torque": self.torque, **self.extras}
        if self.command is not None:
            measured |= by_channel(self.command, self.led)
        return measured if self.velocity is None else measured | {"velocity": self.velocity}


def of_numbers(columns: Columns) -> Columns:
    """Return the same with NaN where what rows need is no number, as of a sensor that is off."""
    needed = {"time": columns.time, "position": columns.position, "torque": columns.torque}
    if columns.command is not None:
        needed["command"] = columns.command
    none = {name: np.abs(values) > BEYOND for name, values in needed.items()}
    odd = {name: np.where(none[name], np.nan, needed[name]) for name in none if none[name].any()}
    return replace(columns, **odd) if odd else columns


def without_wraps(columns: Columns) -> Columns:
    """Return the same with positions that count on, and say so."""
    position, told = np.array(columns.position), list(columns.warnings)
    for j, own in enumerate(columns.position.T):
        if (found := unwrapped(own)) is not None:
            position[:, j] = found.position
            told.append(
                f"position_{j + 1} wraps {found.wraps} time{'s' * (found.wraps > 1)} by "
                f"{found.period:.4g} rad; it is counted on"
            )
    if len(told) == len(columns.warnings):
        return columns
    return replace(columns, position=position, warnings=tuple(told))


@dataclass(frozen=True)
class Unwrapped:
    """Positions of one joint without wraps."""

    position: FloatArray  # (T,) [rad]
    wraps: int
    period: float  # [rad] between the ends


def unwrapped(position: FloatArray) -> Unwrapped | None:
    """Take the wraps out of the positions of a joint; None where there is none.

    A wrap is known by what it does, not by its size alone, since an encoder may sit before a gear:
    the position leaps from one end of all that was recorded to the other, while the joint moves on
    against the leap, and every leap is of the same size. Where that size is a turn, the joint may
    also hover at the ends.

    Args:
        position: (T,) [rad], of samples without gaps; NaN where there is none.
    """
    steps = np.diff(position)
    sizes = np.abs(np.nan_to_num(steps))
    largest = float(sizes.max(initial=0.0))
    if largest < _LEAST or largest < _OF_SPAN * (np.nanmax(position) - np.nanmin(position)):
        return None
    leaps = np.flatnonzero(sizes > (1 - 2 * _OF_WRAP) * largest)
    before = np.array([_usual(steps[max(at - _BESIDE, 0) : at]) for at in leaps])
    after = np.array([_usual(steps[at + 1 : at + 1 + _BESIDE]) for at in leaps])
    if not (np.maximum(np.abs(before), np.abs(after)) < _OF_WRAP * largest).all():
        return None
    sizes = np.abs(steps[leaps] - (before + after) / 2)
    period = float(np.median(sizes))
    if (np.abs(sizes - period) > _ALIKE * period).any():
        return None
    if abs(period - _TURN) < _ALIKE * _TURN:
        period = _TURN
    elif (
        leaps.size < _FEWEST or (np.maximum(before * steps[leaps], after * steps[leaps]) >= 0).any()
    ):
        return None
    count = np.zeros(position.size)
    count[leaps + 1] = -np.sign(steps[leaps])
    return Unwrapped(position + period * np.cumsum(count), leaps.size, period)


def _usual(steps: FloatArray) -> float:
    """Return the median of some steps; 0 where there is none, as at the ends of a recording."""
    known = steps[np.isfinite(steps)]
    return float(np.median(known)) if known.size else 0.0


def unit_of(step: float) -> str | None:
    """Return the unit in which a step of time makes the rate of a recording; None if none does.

    No step does in two units: they are a factor of 1000 apart, and the rates one of 611.
    """
    for unit, per_second in _PER_SECOND.items():
        if step > 0 and RATES[0] <= per_second / step <= RATES[1]:
            return unit
    return None


def seconds(values: NDArray[Any], known: BoolArray | None = None) -> tuple[FloatArray, str]:
    """Return times in seconds, and how they were taken where that has to be said.

    Whole numbers are counted from the first, where their steps can only be micro- or nanoseconds;
    so are dates and durations. The difference is exact: a date in nanoseconds has more digits than
    a float. All other numbers stay what they are.

    Args:
        values: Numbers, dates or durations, (T,).
        known: (T,), false where a whole number stands for an empty cell.

    Returns:
        Time (T,) [s], NaN where it is not known; and a sentence, or nothing.
    """
    if not values.size:
        return np.zeros(0), ""
    if values.dtype.kind in "mM":
        since = values - values[(~np.isnat(values)).argmax()]
        return since / np.timedelta64(1, "s"), f"time holds {values.dtype} values: {_SINCE}"
    if values.dtype.kind not in "iu":
        return np.asarray(values, dtype=np.float64), ""
    known = np.ones(values.shape, dtype=bool) if known is None else known
    since = (values - values[known.argmax()]).astype(np.int64)  # modulo 2**64, so exact
    forward = np.diff(since[known])
    forward = forward[forward > 0]
    step = int(np.median(forward)) if forward.size else 0
    unit = unit_of(step)
    if unit not in _TAKEN:
        return np.where(known, values, np.nan), ""
    text = f"time holds whole numbers with steps of {step}, which are {unit}: {_SINCE}"
    return np.where(known, since / _PER_SECOND[unit], np.nan), text
