"""The stretch of a recording in which simulation and recording differ most."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from estimators.diagnosis.settings.afterwards import LOOPS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.result import Traces
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Stretch:
    """Contiguous rows of the traces, all of one recording."""

    rows: slice
    recording: int  # 0-based
    start: float  # [s], of the recording
    stop: float  # [s]


def worst_stretch(traces: Traces, floor: FloatArray, duration: float) -> Stretch:
    """Find where the given simulation is farthest from the recording beyond its tolerances.

    Args:
        traces: Signals of all recordings.
        floor: Noise floor of each joint, (n,) [N m]; joints are weighed by its inverse.
        duration: Longest stretch wanted [s]; what is contiguous may be shorter.

    Returns:
        The stretch of the largest mean squared residual of joints that are not near rest.
    """
    residual = (traces.measured - traces.tolerances) / np.maximum(floor, 1e-9)
    return _largest(traces, np.sum(np.where(traces.moving, residual, 0.0) ** 2, axis=1), duration)


def loop_stretch(traces: Traces, j: int, duration: float) -> Stretch:
    """Find where tolerances leave much of a joint's torque while it moves within a small range.

    There loops of torque over position can be seen; a reach would squeeze them to a line.

    Args:
        traces: Signals of all recordings.
        j: The joint, 0-based.
        duration: Longest stretch wanted [s].
    """
    error = traces.moving[:, j] * (traces.measured[:, j] - traces.tolerances[:, j]) ** 2
    steps = np.diff(traces.time)
    rows = max(1, round(duration / float(np.median(steps[steps > 0]))))
    q = traces.position[:, j]
    span = maximum_filter1d(q, rows) - minimum_filter1d(q, rows)
    return _largest(traces, error / (span + LOOPS.narrow), duration)


def _largest(traces: Traces, error: FloatArray, duration: float) -> Stretch:
    """Return the stretch of the largest mean of `error`, (K,)."""
    best, found = -1.0, slice(0, len(traces.time))
    for run in contiguous_runs(traces):
        rows = _worst_window(traces.time[run], error[run], duration)
        # A window that is cut short has to be worse than a full one in proportion.
        length = traces.time[run][rows][-1] - traces.time[run][rows][0]
        score = float(error[run][rows].mean()) * min(1.0, length / duration)
        if score > best:
            best, found = score, slice(run.start + rows.start, run.start + rows.stop)
    time = traces.time[found]
    return Stretch(found, int(traces.recording[found.start]), float(time[0]), float(time[-1]))


def contiguous_runs(traces: Traces) -> list[slice]:
    """Return the stretches of one recording each, without gaps."""
    steps = np.diff(traces.time)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    breaks = (np.diff(traces.recording) != 0) | (steps > 5 * usual) | (steps <= 0)
    bounds: NDArray[np.intp] = np.concatenate([[0], np.flatnonzero(breaks) + 1, [len(traces.time)]])
    return [slice(a, b) for a, b in pairwise(bounds.tolist())]


def _worst_window(time: FloatArray, error: FloatArray, duration: float) -> slice:
    """Return the rows of the window of `duration` with the largest sum of `error`."""
    ends = np.searchsorted(time, time + duration, side="right")
    total = np.append(0.0, np.cumsum(error))
    start = int(np.argmax(total[ends] - total[:-1]))
    return slice(start, int(ends[start]))
