"""What drives are told: positions, velocities or torques, each in columns of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.types import FloatArray

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray


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


def led_by(channel: CommandChannel, channels: Sequence[str]) -> NDArray[np.bool_]:
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
    own = {name: led_by(CHANNELS[name], channels) for name in dict.fromkeys(channels)}
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
    told = f"lacks {name}_{joint}: the drive of joint {joint} takes {CHANNELS[name].unit}"
    has = [f"{other}_{joint} [{CHANNELS[other].unit}]" for other in known]
    return f"{told}, and what was recorded is {', '.join(has)}" if has else told
