"""Means and spreads of a residual over what it may depend on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.afterwards import BINS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


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


def bins_of(rows: int, most: int = BINS.most) -> int:
    """Return into how many bins of a profile some rows go."""
    return int(np.clip(rows / BINS.rows, BINS.fewest, most))


def cells_of(rows: int) -> int:
    """Return into how many cells of a map, to either side, some rows go."""
    return int(np.clip(np.sqrt(rows / BINS.rows_of_cell), BINS.fewest_cells, BINS.most_cells))


def edges_of(values: FloatArray, bins: int, *, logarithmic: bool = False) -> FloatArray:
    """Return edges of even bins over the bulk of `values` (K,), in their logarithm if wanted."""
    if logarithmic:
        values = np.log10(values[values > 0])
    known = values[np.isfinite(values)]
    if not known.size:
        return np.linspace(0.0, 1.0, bins + 1)
    low, high = np.percentile(known, BINS.outer)
    if high - low < 1e-9:  # noqa: PLR2004  # nothing varies: one bin holds it all
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
    few = count < _fewest(count, BINS.enough)
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
    mean[count < _fewest(count, BINS.enough_of_cell)] = np.nan
    return Map(
        (x_edges[1:] + x_edges[:-1]) / 2, (y_edges[1:] + y_edges[:-1]) / 2, mean.reshape(shape)
    )


def _fewest(count: FloatArray, enough: int) -> float:
    """Return how many rows a bin needs to be shown, given those of all bins."""
    visited = count[count > 0]
    usual = float(visited.mean()) if visited.size else 0.0
    return float(np.clip(BINS.shown * usual, BINS.least, enough))


def _inside(values: FloatArray, edges: FloatArray) -> NDArray[np.bool_]:
    return (values >= edges[0]) & (values <= edges[-1])


def _bins(values: FloatArray, edges: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the bin of each value within the edges, and which those are, (K,)."""
    rows = _inside(values, edges)
    which = np.searchsorted(edges, values[rows], side="right") - 1
    return np.minimum(which, len(edges) - 2), rows
