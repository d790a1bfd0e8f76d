"""Silent torques: those of joints whose torque was not measured, whatever its column holds."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.recordings.gate.held_values import held_torque

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.recordings.columns import Columns
    from limo_driver.types import FloatArray

_MOSTLY: Final = 0.5  # of the rows in which a joint moves
_WITHIN: Final = 0.1  # [s], in which a joint that moves does so
_BY: Final = 1e-3  # [rad], beyond the noise of encoders
_FARTHEST: Final = 0.02  # [rad], that a joint at rest does not reach by the steps of its encoder


def without_silent_torques(columns: Columns) -> Columns:
    """Return the same with 0 for torques that nobody measured, and say so.

    A column without a number is one. So is one that is 0, or at its limit, in most of the rows in
    which its joint moves, for longer than the noise of the others allows: a current within its dead
    band, or a sensor that can tell no more. The few rows between say when it wakes, and not what
    the joint feels.
    """
    if not np.isfinite(columns.torque).any():
        return columns
    told: dict[int, str] = {}  # by joint, 0-based
    every = zip(columns.position.T, columns.torque.T, strict=True)
    for j, (position, values) in enumerate(every):
        if not np.isfinite(values).any():
            told[j] = "is never measured; it is kept as 0"
        elif (held := _mostly(columns.time, position, values)) is not None:
            told[j] = (
                f"is {held[0] + 0.0:.4g} in {held[1]:.0%} of the rows in which its joint moves, "
                "and measures nothing; it is kept as 0"
            )
    if not told:
        return columns
    torque = np.array(columns.torque)
    torque[:, list(told)] = 0.0
    said = (f"torque_{j + 1} {what}" for j, what in told.items())
    return replace(columns, torque=torque, warnings=(*columns.warnings, *said))


def _mostly(
    time: FloatArray, position: FloatArray, torque: FloatArray
) -> tuple[float, float] | None:
    """Return the value that a torque has in most rows in motion, and in which part; None if none.

    Args:
        time: (T,) [s].
        position: (T,) [rad], of one joint.
        torque: (T,) [N m], of the same joint.
    """
    known = np.isfinite(time) & np.isfinite(position) & np.isfinite(torque)
    latest = np.maximum.accumulate(np.where(known, time, -np.inf))
    known[1:] &= time[1:] > latest[:-1]  # rows out of time are judged one by one, later
    time, position, torque = time[known], position[known], torque[known]
    if time.size < 2 or np.ptp(position) < _FARTHEST:  # noqa: PLR2004  # a rate takes two
        return None
    moves = _moves(time, position)
    if not moves.any():
        return None
    value = float(np.median(torque[moves]))  # that of more than half, if there is one
    part = float(np.mean(torque[moves] == value))
    if part <= _MOSTLY or value not in {0.0, float(torque.min()), float(torque.max())}:
        return None
    return (value, part) if held_torque(time, position, torque).any() else None


def _moves(time: FloatArray, position: FloatArray) -> NDArray[np.bool_]:
    """Mark the rows (T,) after which a joint moves."""
    ahead = max(1, round(_WITHIN / float(np.median(np.diff(time)))))
    moves = np.zeros(time.size, dtype=bool)
    moves[:-ahead] = np.abs(position[ahead:] - position[:-ahead]) > _BY
    return moves
