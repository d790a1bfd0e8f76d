"""Columns of a log before its rows are judged, and wraps of positions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.recordings.channels import by_channel, channels_of
from limo_driver.recordings.unwrapping import unwrapped

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


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
