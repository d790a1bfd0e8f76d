"""Means and spreads of a residual over what it may depend on."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from estimators.diagnosis.settings import FEW, TAIL, TINY
from estimators.diagnosis.settings.judgement import BINS
from estimators.diagnosis.settings.residuals import ROWS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.diagnosis.result import Traces
    from limo_driver.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Profile:
    """Statistics of a residual in B bins of another quantity; NaN where there are few rows."""

    edges: FloatArray  # (B + 1,), unit of the quantity
    centre: FloatArray  # (B,), unit of the quantity
    mean: FloatArray  # (B,) [N m]
    spread: FloatArray  # (B,) standard deviation [N m]
    rms: FloatArray  # (B,) [N m]

    def runs(self) -> list[slice]:
        """Return the stretches of bins that have rows enough, one beside the other."""
        known = np.concatenate([[False], np.isfinite(self.mean), [False]])
        ends = np.flatnonzero(np.diff(known.astype(int)))
        return [slice(a, b) for a, b in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True)]

    def drawn(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return abscissae and values (B,) as a curve over whole bins, NaN between its runs."""
        x, y = [], []
        for run in self.runs():
            x += [self.edges[run.start], *self.centre[run], self.edges[run.stop], np.nan]
            y += [values[run.start], *values[run], values[run.stop - 1], np.nan]
        return np.array(x), np.array(y)


@dataclass(frozen=True)
class Map:
    """Mean of a residual over two quantities; NaN where there are few rows."""

    x: FloatArray  # (B,)
    y: FloatArray  # (C,)
    mean: FloatArray  # (C, B) [N m]


def bins_of(rows: int) -> int:
    """Return into how many bins of a profile some rows go."""
    return int(np.clip(rows / BINS.rows, BINS.fewest, BINS.most))


def cells_of(rows: int) -> int:
    """Return into how many cells of a map, to either side, some rows go."""
    return int(np.clip(np.sqrt(rows / FEW), BINS.fewest, BINS.most))


def edges_of(values: FloatArray, bins: int, *, logarithmic: bool = False) -> FloatArray:
    """Return edges of even bins over the bulk of `values` (K,), in their logarithm if wanted."""
    if logarithmic:
        values = np.log10(values[values > 0])
    known = values[np.isfinite(values)]
    if not known.size:
        return np.linspace(0.0, 1.0, bins + 1)
    low, high = np.quantile(known, (TAIL, 1 - TAIL))
    if high - low < TINY:  # nothing varies: one bin holds it all
        low, high = low - 0.5, high + 0.5
    edges: FloatArray = np.linspace(low, high, bins + 1)
    return 10.0**edges if logarithmic else edges


def profile(values: FloatArray, residual: FloatArray, edges: FloatArray) -> Profile:
    """Average `residual` (K,) [N m] over bins of `values` (K,)."""
    which, rows = _bins(values, edges)
    count = np.bincount(which, minlength=len(edges) - 1).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(which, residual[rows], len(edges) - 1) / count
        square = np.bincount(which, residual[rows] ** 2, len(edges) - 1) / count
    few = count < FEW
    mean[few] = square[few] = np.nan
    spread = np.sqrt(np.maximum(square - mean**2, 0.0))
    return Profile(edges, (edges[1:] + edges[:-1]) / 2, mean, spread, np.sqrt(square))


def residual_map(
    x: FloatArray, y: FloatArray, residual: FloatArray, x_edges: FloatArray, y_edges: FloatArray
) -> Map:
    """Average `residual` (K,) [N m] over cells of `x` and `y`, (K,) each."""
    inside = _inside(x, x_edges) & _inside(y, y_edges)
    columns, _ = _bins(x[inside], x_edges)
    lines, _ = _bins(y[inside], y_edges)
    shape = (len(y_edges) - 1, len(x_edges) - 1)
    cell = lines * shape[1] + columns
    count = np.bincount(cell, minlength=shape[0] * shape[1]).astype(float)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell, residual[inside], shape[0] * shape[1]) / count
    mean[count < FEW] = np.nan
    return Map(
        (x_edges[1:] + x_edges[:-1]) / 2, (y_edges[1:] + y_edges[:-1]) / 2, mean.reshape(shape)
    )


def _inside(values: FloatArray, edges: FloatArray) -> BoolArray:
    return (values >= edges[0]) & (values <= edges[-1])


def _bins(values: FloatArray, edges: FloatArray) -> tuple[NDArray[np.intp], BoolArray]:
    """Return the bin of each value within the edges, and which those are, (K,)."""
    rows = _inside(values, edges)
    which = np.searchsorted(edges, values[rows], side="right") - 1
    return np.minimum(which, len(edges) - 2), rows


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
    residual = (traces.measured - traces.tolerances) / np.maximum(floor, TINY)
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
    return _largest(traces, error / (span + ROWS.travel), duration)


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
