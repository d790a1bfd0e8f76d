"""Velocities: do those of a log say what its positions do?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.recordings.gate.gaps import longest_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.recordings.columns import Columns
    from limo_driver.types import FloatArray

_SWUNG = 0.02  # [rad], range of a joint whose velocity can be judged
_SWEEP = 0.1  # [s] over which velocity and change of position are compared


def velocity_factor(time: FloatArray, position: FloatArray, velocity: FloatArray) -> float | None:
    """Return velocity over rate of change of position, by least squares; None if nothing moves.

    All are (T,), of one joint. Sums over stretches are compared, since a difference quotient of
    close samples is all noise.
    """
    step = np.diff(time)
    swept = (velocity[1:] + velocity[:-1]) / 2 * step
    known = np.isfinite(swept) & (step < longest_step(step))
    if not known.any():
        return None
    stride = max(1, round(_SWEEP / float(np.median(step))))
    starts = np.arange(0, step.size, stride)
    says = np.add.reduceat(np.where(known, swept, 0.0), starts)
    does = np.add.reduceat(np.where(known, np.diff(position), 0.0), starts)
    energy = float(does @ does)
    return float(says @ does) / energy if energy > 0 else None


def swept(columns: Columns, rows: NDArray[np.int64], joint: int) -> float:
    """Return the range of motion in a recorded velocity, without drift [rad]; 0 if none is."""
    if columns.velocity is None:
        return 0.0
    velocity = np.nan_to_num(columns.velocity[rows, joint])
    path = np.cumsum((velocity - velocity.mean()) * np.gradient(columns.time[rows]))
    return float(np.ptp(path))


def velocity_factors(columns: Columns, rows: NDArray[np.int64]) -> dict[int, float]:
    """Return how many times the rate of change of position each moving joint's velocity is."""
    if columns.velocity is None:
        return {}
    position = columns.position[rows]
    velocity = columns.velocity[rows]
    return {
        j: factor
        for j in np.flatnonzero(np.ptp(position, axis=0) > _SWUNG).tolist()
        if (factor := velocity_factor(columns.time[rows], position[:, j], velocity[:, j]))
        is not None
    }
