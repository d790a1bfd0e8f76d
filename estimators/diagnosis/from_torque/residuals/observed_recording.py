"""One recording as a diagnosis takes it: filtered, on an even grid, thinned to independent rows."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d

from estimators.diagnosis.settings.residuals import ROWS
from limo_driver.types import BoolArray, FloatArray, IntArray, Motion

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording


@dataclass(frozen=True)
class ObservedRecording:
    """One recording, filtered, on an even grid, and thinned to what the sharp bandwidth needs."""

    sharp: Motion
    smooth: Motion
    measured: FloatArray  # (T, n) [N m]
    segments: tuple[slice, ...]
    kept: IntArray  # samples that are rows of the slow grid
    unmeasured: BoolArray  # (T, n) torques that are none, as far as the filter spreads them

    @classmethod
    def of(cls, recording: Recording, bandwidth: float) -> ObservedRecording:
        """Filter a recording.

        Args:
            recording: Of any rate.
            bandwidth: Of the filter [Hz].

        Raises:
            RecordingError: The bandwidth does not suit the recording.
        """
        measured = recording.filtered_torque(bandwidth)
        stride = max(1, int(recording.rate / (ROWS.samples_per_bandwidth * bandwidth)))
        chosen = [np.arange(rows.start, rows.stop, stride) for rows in recording.segments]
        grids = [_even(recording.time[rows]) for rows in chosen]
        ends = np.cumsum([0, *(grid.size for grid in grids)])
        segments = tuple(slice(a, b) for a, b in pairwise(ends.tolist()))
        time = np.concatenate(grids)

        def on_grid(values: FloatArray) -> FloatArray:
            """Read smooth values (all samples, ...) on the grids."""
            parts = [
                values[rows] if grid.size == rows.size and (grid == recording.time[rows]).all()
                else CubicSpline(recording.time[rows], values[rows])(grid)
                for rows, grid in zip(chosen, grids, strict=True)
            ]  # fmt: skip
            return np.concatenate(parts)

        def moved(motion: Motion) -> Motion:
            warmth = motion.temperature
            return Motion(
                time,
                on_grid(motion.position),
                on_grid(motion.velocity),
                on_grid(motion.acceleration),
                # linear, since a joint without any reading is not a number throughout
                None
                if warmth is None
                else np.stack([np.interp(time, recording.time, x) for x in warmth.T], axis=1),
            )

        edges = on_grid(recording.edges(bandwidth).astype(float)) > 0.5  # noqa: PLR2004  # nearer to an edge than not
        return cls(
            moved(recording.sharp_motion(bandwidth)),
            moved(recording.motion(bandwidth)),
            on_grid(measured),
            segments,
            _slow_rows(time, segments, ~edges, bandwidth),
            on_grid(_unmeasured(recording, bandwidth).astype(float)) > 0.5,  # noqa: PLR2004  # nearer to one
        )


def _unmeasured(recording: Recording, bandwidth: float) -> BoolArray:
    """Mark torques (T, n) that are no measurement, or that the filter mixes with some.

    Those of a joint whose torque is one value in all rows are none, either.
    """
    result = np.broadcast_to(~recording.measured_joints, recording.torque.shape)
    if recording.unmeasured is None:
        return result
    reach = max(1, round(1.0 / bandwidth * recording.rate))
    spread = maximum_filter1d(recording.unmeasured, 2 * reach + 1, axis=0)
    return np.logical_or(result, spread)


def _even(time: FloatArray) -> FloatArray:
    """Return the even grid nearest to rising times; the times themselves where they are even.

    All columns pass the filter many times, which is quick on an even grid alone.
    """
    count = round((time[-1] - time[0]) / float(np.median(np.diff(time)))) + 1
    grid = np.linspace(time[0], time[-1], count)
    if count == time.size and np.abs(grid - time).max() < ROWS.even * (grid[1] - grid[0]):
        return time
    return grid


def _slow_rows(
    time: FloatArray, segments: Sequence[slice], inside: BoolArray, bandwidth: float
) -> IntArray:
    """Return the samples of the slow grid: at most so many per second, none at an edge."""
    period = 1.0 / (ROWS.per_bandwidth * bandwidth)
    kept: list[IntArray] = []
    for rows in segments:
        cell = np.floor((time[rows] - time[rows.start]) / period)
        first = np.flatnonzero(np.diff(cell, prepend=-1)) + rows.start
        kept.append(first[inside[first]])
    return np.concatenate(kept)
