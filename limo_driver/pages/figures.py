"""Charts of pages as plotly figures: axes, curves and colours that all pages have alike."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.runtime.display import joint_labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.pages.markup import Figure
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray

MEASURED, BEFORE, AFTER, FLOOR = "#868f98", "#d9730d", "#0b559f", "#868f98"
OTHER: Final = "#75899d"  # what is neither before nor after
# Of joints: none of the colours that tell simulations apart.
JOINTS: Final = ("#2e7d32", "#6a3d9a", "#00838f", "#8c564b", "#c1272d", "#7a8a00", "#66707a")
WIDE, NARROW = 4.0, 1.4  # lines: of what was measured, and of what is laid over it
DRAWN: Final = 1200  # samples of a curve: more cannot be seen
_MANY_DECADES: Final = 2.5  # of a logarithmic axis
_STILL: Final = 1e-6  # [rad] of rounding, within which a joint rests


def layout(x: str, y: str) -> Figure:
    """Return the axes that every chart begins with.

    Args:
        x: Title of the axis, with its unit.
        y: The same of the other axis.
    """
    axis = {"gridcolor": "#eceef0", "zerolinecolor": "#c9ced4", "linecolor": "#c9ced4",
            "ticks": "outside", "ticklen": 3, "tickcolor": "#c9ced4",
            "exponentformat": "none"}  # fmt: skip
    return {
        "xaxis": axis | {"title": {"text": x, "standoff": 8}, "automargin": True},
        "yaxis": axis | {"title": {"text": y, "standoff": 6}, "automargin": True},
        "font": {"family": "inherit", "size": 11.5, "color": "#3d4650"},
        "margin": {"l": 52, "r": 12, "t": 8, "b": 44},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0,
                   "font": {"size": 11}},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "hovermode": "closest",
    }  # fmt: skip


def curve(x: FloatArray, y: FloatArray, name: str, colour: str, width: float = 1.8) -> Figure:
    """Return a line through points x (K,), y (K,); it is broken where either is NaN."""
    return {
        "x": numbers(x, 6), "y": numbers(y, 5), "mode": "lines", "name": name,
        "line": {"color": colour, "width": width},
    }  # fmt: skip


def dots(
    values: Sequence[float], names: Sequence[str], name: str, marker: Figure, unit: str = "N m"
) -> Figure:
    """Return one mark in the row of each name."""
    return {
        "x": numbers(np.array(values, dtype=float)), "y": list(names), "mode": "markers",
        "name": name, "marker": marker,
        "hovertemplate": "%{y}, " + name + ": %{x} " + unit + "<extra></extra>",
    }  # fmt: skip


def numbers(values: FloatArray, digits: int = 4) -> list[float | None]:
    """Return plain numbers of few digits, as JSON wants them; what is not finite is None."""
    few = f".{digits}g"
    return [float(format(v, few)) if math.isfinite(v) else None for v in values.tolist()]


def joint_motion(trajectory: Trajectory, names: Sequence[str]) -> Figure:
    """Positions of the joints that move, from where they start, by their names."""
    step = max(1, len(trajectory) // DRAWN)
    moved = trajectory.position[::step] - trajectory.position[0]
    data = [
        curve(trajectory.time[::step], moved[:, j], label, JOINTS[j % len(JOINTS)])
        for j, label in enumerate(joint_labels(names))
        if np.ptp(trajectory.position[:, j]) > _STILL
    ]
    axes = layout("time [s]", "position from the start [rad]")
    return {"data": data, "layout": axes | {"showlegend": True}, "height": 300}


def rounded_ticks(values: FloatArray) -> Figure:
    """Return ticks of a logarithmic axis: 1, 2, 5 of a decade, more within one, less over many."""
    known = values[np.isfinite(values) & (values > 0)]
    if not known.size:
        return {}
    low, high = np.log10(known.min()), np.log10(known.max())
    steps = (1, 2, 5) if high - low < _MANY_DECADES else (1,)
    steps = (1, 2, 3, 4, 5, 7) if high - low < 1 else steps
    decades = range(int(np.floor(low)) - 1, int(np.ceil(high)) + 1)
    ticks = [float(f"{step}e{k}") for k in decades for step in steps]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}
