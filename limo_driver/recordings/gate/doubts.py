"""What a user should know of the rows of a recording that can be used."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.recordings.channels import VELOCITY, led_by
from limo_driver.recordings.gate.gaps import contiguous
from limo_driver.recordings.gate.velocities import velocity_factors

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.recordings.columns import Columns
    from limo_driver.types import FloatArray

STILL = 2e-3  # [rad], range of a joint that does not move
_FACTORS = (0.5, 2.0)  # of velocity to rate of change, that filters and noise may make
_TURNS = 4 * np.pi  # [rad]; few arms turn farther


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
    return [
        f"velocity_{j + 1} is {factor:.3g} times the rate of change of position_{j + 1}; "
        "it is not used"
        for j, factor in velocity_factors(columns, rows).items()
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
