"""Closure: how well a simulation predicts held-out torque, against the noise floor.

Torques are compared below 10 Hz, over the rows in which the joint moves and is a tenth of a second,
the reach of the filter, away from rest: nearer, a sample is a mixture of rest and motion, and no
encoder tells when exactly the sign of friction turned. On four recordings of nulls, the plant's own
equations on positions below 10 Hz come to 1.00 to 1.16 noise floors at each joint so, and to 1.01
to 4.66 over all moving rows; the score prints both. Measured torque, prediction and noise all go
through the same zero-phase filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow.parquet as pq
from scipy.ndimage import maximum_filter1d
from scipy.signal import butter, sosfiltfilt

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

BAND = 10.0  # [Hz]
MOVING = 0.003  # [rad/s]
GUARD = 0.1  # [s] around rest, over which the filter mixes rest and motion
_EDGE = 0.5  # [s] at either end that a filter without phase does not know


@dataclass(frozen=True)
class Closure:
    """Held-out RMSE of one case, at each joint, (n,) [N m]."""

    before: Array
    after: Array
    floor: Array

    @property
    def worst(self) -> float:
        """Return the worst joint's RMSE over its noise floor."""
        return float((self.after / self.floor).max())

    @property
    def removed(self) -> float:
        """Return the share of the reducible error that is gone."""
        reducible = float(np.sum(self.before**2 - self.floor**2))
        left = float(np.sum(self.after**2 - self.floor**2))
        return 1 - max(left, 0.0) / reducible if reducible > 0 else nan


def closure(case: Path, out: str = "out", guard: float = GUARD) -> Closure | None:
    """Compare both simulations on held-out motion; None where a prediction is missing.

    Args:
        case: Folder of the case.
        out: Folder in it with the predictions.
        guard: Time around rest whose rows are left out [s].
    """
    sums: list[Array] = []
    for k in (1, 2):
        after, before = case / out / f"after_{k}.parquet", case / out / f"before_{k}.parquet"
        if not (after.exists() and before.exists()):
            return None
        table = pq.read_table(case / f"held_out_{k}.parquet")
        measured = columns(table, "torque")
        clean = np.load(case / "hidden" / f"held_out_{k}.npz")["torque"]
        time = table["time"].to_numpy()
        errors = [measured - columns(pq.read_table(path), "torque") for path in (before, after)]
        sums.append(squares(time, columns(table, "position"), [*errors, measured - clean], guard))
    total = np.sum(sums, axis=0)  # (4, n): sums of squares, then rows
    before, after, floor = np.sqrt(total[:3] / np.maximum(total[3], 1))
    return Closure(before, after, floor)


def squares(time: Array, position: Array, errors: Sequence[Array], guard: float = GUARD) -> Array:
    """Return the sum of squares of each error below 10 Hz over moving rows, and their number.

    Args:
        time: (T,) [s].
        position: (T, n) [rad].
        errors: (T, n) each; rows that are not numbers are left out.
        guard: Time around rest whose rows are left out [s].

    Returns:
        (len(errors) + 1, n), the last row the number of rows.
    """
    usable = np.all([np.isfinite(error).all(axis=1) for error in errors], axis=0)
    time = time[usable]
    rate = 1 / float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], 1 / rate)
    sos = butter(4, BAND, fs=rate, output="sos")

    def low(values: Array) -> Array:
        gridded = np.stack([np.interp(even, time, c) for c in values[usable].T], axis=1)
        return np.asarray(sosfiltfilt(sos, gridded, axis=0))

    velocity = np.gradient(low(position), 1 / rate, axis=0)
    inside = (even > even[0] + _EDGE) & (even < even[-1] - _EDGE)
    still = np.abs(velocity) <= MOVING
    near = maximum_filter1d(still, 2 * round(guard * rate) + 1, axis=0)
    rows = ~near & inside[:, None]
    return np.array([*((low(e) ** 2 * rows).sum(axis=0) for e in errors), rows.sum(axis=0)])


def columns(table: Any, quantity: str) -> Array:  # noqa: ANN401  # pyarrow ships no stubs
    """Return the columns of a quantity, (T, n)."""
    n = sum(name.startswith(f"{quantity}_") for name in table.column_names)
    return np.stack([table[f"{quantity}_{j + 1}"].to_numpy() for j in range(n)], axis=1)
