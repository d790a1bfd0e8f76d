"""What is odd about a recording's rows, what was left out of it, and torques that are silent."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.recordings.channels import VELOCITY, led_by
from limo_driver.recordings.gate.held_values import (
    contiguous,
    held_torque,
    one_factor,
    velocity_factors,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.recordings.channels import Columns
    from limo_driver.types import FloatArray

STILL = 2e-3  # [rad], range of a joint that does not move
_FACTORS = (0.5, 2.0)  # of velocity to rate of change, that filters and noise may make
_TURNS = 4 * np.pi  # [rad]; few arms turn farther
_LISTED = 12  # stretches of rows that a message names
_MOSTLY: Final = 0.5  # of the rows in which a joint moves
_WITHIN: Final = 0.1  # [s], in which a joint that moves does so
_BY: Final = 1e-3  # [rad], beyond the noise of encoders
_FARTHEST: Final = 0.02  # [rad], that a joint at rest does not reach by the steps of its encoder


def doubts_about_rows(columns: Columns, rows: NDArray[np.int64]) -> tuple[str, ...]:
    """Return what is odd about rows that are kept, in a sentence each.

    Args:
        columns: Of the whole recording.
        rows: That can be used, (T,).
    """
    return (
        *(() if columns.spread else about_gaps(columns.time[rows])),
        *_about_joints(columns, rows),
        *_about_velocity(columns, rows),
        *_about_holes(columns, rows),
    )


def _about_velocity(columns: Columns, rows: NDArray[np.int64]) -> list[str]:
    factors = velocity_factors(columns, rows)
    factor = one_factor(np.array(list(factors.values())))
    if factor is not None and len(factors) > 1:
        return [
            f"velocity is {factor:.3g} times the rate of change of position at all joints: does "
            f"the time run {factor:.3g} times as fast as it should? The velocity is not used"
        ]
    return [
        f"velocity_{j + 1} is {factor:.3g} times the rate of change of position_{j + 1}; "
        "it is not used"
        for j, factor in factors.items()
        if not _FACTORS[0] < factor < _FACTORS[1]
    ]


def about_gaps(time: FloatArray) -> list[str]:
    """Say how many gaps there are, and which is the longest.

    Args:
        time: Increasing, (T,) [s].
    """
    starts = [rows.start for rows in contiguous(time)[1:]]
    if not starts:
        return []
    lengths = [float(time[start] - time[start - 1]) for start in starts]
    worst = int(np.argmax(lengths))
    return [
        f"{len(starts)} gap{'s' * (len(starts) > 1)}; the longest, {lengths[worst]:.3g} s, "
        f"after {time[starts[worst] - 1]:.6g} s"
    ]


def _about_joints(columns: Columns, rows: NDArray[np.int64]) -> list[str]:
    found: list[str] = []
    turning = led_by(VELOCITY, columns.led)  # as wheels do, turn after turn
    for j in range(columns.position.shape[1]):
        position = columns.position[rows, j]
        torque = columns.torque[rows, j]
        if not turning[j] and (farthest := float(np.abs(position).max())) > _TURNS:
            found.append(
                f"position_{j + 1} reaches {farthest:.4g} rad, {farthest / (2 * np.pi):.3g} "
                "turns; is it in degrees?"
            )
        if np.ptp(position) < STILL:
            found.append(f"joint {j + 1} never moves (range {np.ptp(position):.2g} rad)")
        told = any(known.startswith(f"torque_{j + 1} ") for known in columns.warnings)
        no_torque = columns.command is not None and torque[0] == 0
        if np.ptp(torque) == 0 and not (told or no_torque):
            found.append(f"torque_{j + 1} is always {torque[0]:g} N m")
    return found


def _about_holes(columns: Columns, rows: NDArray[np.int64]) -> list[str]:
    found: list[str] = []
    for quantity, values in columns.quantities().items():
        if holes := int((~np.isfinite(values[rows])).any(axis=1).sum()):
            found.append(f"{quantity} is missing in {holes} rows")
    return found


@dataclass(frozen=True)
class LeftOut:
    """Rows of a file that cannot be used."""

    reason: str
    rows: tuple[int, ...]  # 0-based rows of the file

    def __str__(self) -> str:
        """Name the rows, as `3 rows left out: a value is impossible (rows 1-2, 7)`."""
        rows = np.array(self.rows)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
        listed = [f"{run[0]}" if run.size == 1 else f"{run[0]}-{run[-1]}" for run in runs]
        more = f" and {len(listed) - _LISTED} more stretches" if len(listed) > _LISTED else ""
        many = "s" * (rows.size > 1)
        return (
            f"{rows.size} row{many} left out: {self.reason} "
            f"(row{many} {', '.join(listed[:_LISTED])}{more})"
        )


@dataclass(frozen=True)
class UsableRows:
    """Usable rows, the rows left out by reason, and warnings about the others."""

    rows: NDArray[np.int64]  # (T,)
    left_out: tuple[LeftOut, ...]
    warnings: tuple[str, ...]


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
