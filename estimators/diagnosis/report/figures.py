"""The charts of a report as plotly figures: plain values that become JSON."""

from __future__ import annotations

from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.report.binning import (
    Profile,
    bins_of,
    cells_of,
    contiguous_runs,
    edges_of,
    profile,
    residual_map,
)
from estimators.diagnosis.settings import TAIL, TINY
from limo_driver.model.units import unit_of
from limo_driver.pages.figures import (
    AFTER,
    BEFORE,
    DRAWN,
    FLOOR,
    JOINTS,
    LINE,
    MEASURED,
    NARROW,
    OTHER,
    WIDE,
    curve,
    joint_errors,
    layout,
    numbers,
)
from limo_driver.runtime.display import joint_labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.report.binning import Stretch
    from estimators.diagnosis.result import Explanation, Replay, Shift, Traces
    from estimators.diagnosis.verdict import Fit
    from limo_driver.pages.markup import Figure
    from limo_driver.types import BoolArray, FloatArray

TOLERANCES = "#2f9e6f"
_BANDS = {
    BEFORE: "rgba(217,115,13,0.16)",
    TOLERANCES: "rgba(47,158,111,0.18)",
    AFTER: "rgba(11,85,159,0.16)",
}
_DIVERGING = [[0.0, "#0b559f"], [0.25, "#8fb4d9"], [0.5, "#f7f7f5"], [0.75, "#efb27a"],
              [1.0, "#b4560a"]]  # fmt: skip
_FEW_TICKS = 100.0  # range of a logarithmic axis below which decades alone are too few ticks
_AROUND = 1.0  # [s] drawn before and after a push
_GAP = np.full((2, 1), np.nan)  # between two outlines of one trace
_FADED = 0.25  # opacity of rows that are not scored
_BOTH = ("before", "after")
_SIDES = {
    "before": ("given simulation", BEFORE),
    "tolerances": ("within tolerances", TOLERANCES),
    "after": ("improved simulation", AFTER),
}
_LABELS = {
    "position": ("position", "rad"),
    "velocity": ("velocity", "rad/s"),
    "load": ("rigid-body torque", "N m"),
    "since_reversal": ("distance since reversal", "rad"),
    "time": ("time, recordings end to end", "s"),
}


def _label(traces: Traces | Replay, j: int, name: str, unit: str) -> str:
    return f"{name} [{unit_of(unit, traces.sliding, j)}]"


def summary(fit: Fit, names: Sequence[str]) -> Figure:
    """Held-out RMSE of each joint before and after, beside the noise floor."""
    sides = [
        ("noise floor", fit.noise_floor, "line-ns-open", FLOOR),
        ("given simulation", fit.heldout_rmse_before, "circle-open", BEFORE),
        ("within tolerances", fit.heldout_rmse_tolerances, "diamond-open", TOLERANCES),
        ("improved simulation", fit.heldout_rmse_after, "circle", AFTER),
    ]
    chart = joint_errors(
        [side for side in sides if side[1]], joint_labels(names), fit.unit, "held-out RMSE"
    )
    lines, where = list[float | None](), list[str | None]()
    for name, *ends in zip(
        joint_labels(names), fit.heldout_rmse_before, fit.heldout_rmse_after, strict=True
    ):
        lines += [*ends, None]
        where += [name, name, None]
    fall = {"x": lines, "y": where, "mode": "lines", "hoverinfo": "skip", "showlegend": False,
            "line": {"color": "#c9ced4", "width": WIDE}}  # fmt: skip
    return chart | {"data": [fall, *chart["data"]]}


def dependence(
    traces: Traces, j: int, quantity: str, floor: float, sides: Sequence[str] = _BOTH
) -> Figure:
    """Mean and spread of a joint's residual over one quantity, before and after; not near rest."""
    after_reversal, over_time = quantity == "since_reversal", quantity == "time"
    moving = traces.moving[:, j]
    values = (_end_to_end(traces) if over_time else getattr(traces, quantity)[:, j])[moving]
    # Friction points against the motion: after a reversal only its size is alike both ways.
    sign = np.sign(traces.velocity[moving, j]) if after_reversal else 1.0
    edges = edges_of(values, bins_of(len(values)), logarithmic=after_reversal)
    data: list[Figure] = []
    for side in sides:
        name, colour = _SIDES[side]
        found = profile(values, _residual(traces, side, j)[moving] * sign, edges)
        shown = found.rms if over_time else found.mean
        if not over_time:
            data.append(_band(found, colour))
        data.append(curve(*found.drawn(shown), name, colour) | {"showlegend": False})
    what = {"since_reversal": "residual along motion", "time": "residual, RMS"}
    axes = layout(
        _label(traces, j, *_LABELS[quantity]),
        _label(traces, j, what.get(quantity, "residual"), "N m"),
    )
    axes["shapes"] = [_level(y) for y in ((floor,) if over_time else (-floor, floor))]
    if over_time:
        axes["yaxis"] |= {"rangemode": "tozero"}
        axes["shapes"] += [_divider(x) for x in _joins(traces)]
    if after_reversal:
        # one tick a decade; where there is hardly one, at 1, 2 and 5, too
        dtick = 1 if edges[-1] > _FEW_TICKS * edges[0] else "D2"
        axes["xaxis"] |= {"type": "log", "dtick": dtick, "exponentformat": "power"}
    return {"data": data, "layout": axes}


def maps(traces: Traces, j: int, sides: Sequence[str] = _BOTH) -> list[Figure]:
    """Mean residual of a joint over position and velocity, on one scale; not near rest."""
    moving = traces.moving[:, j]
    q, v = traces.position[moving, j], traces.velocity[moving, j]
    x, y = edges_of(q, cells_of(len(q))), edges_of(v, cells_of(len(v)))
    found = [residual_map(q, v, _residual(traces, side, j)[moving], x, y) for side in sides]
    known = np.abs(np.concatenate([item.mean[np.isfinite(item.mean)] for item in found]))
    scale = max(float(np.quantile(known, 1.0 - TAIL)), TINY) if known.size else 1.0
    far, push = (unit_of(unit, traces.sliding, j) for unit in ("rad", "N m"))
    figures: list[Figure] = []
    for item in found:
        axes = layout(*(_label(traces, j, *_LABELS[x]) for x in ("position", "velocity")))
        heat = {
            "type": "heatmap", "x": numbers(item.x), "y": numbers(item.y),
            "z": [numbers(row) for row in item.mean], "zmin": -scale, "zmax": scale,
            "colorscale": _DIVERGING, "hoverongaps": False,
            "hovertemplate": f"%{{x}} {far}, %{{y}} {far}/s: %{{z}} {push}<extra></extra>",
            "colorbar": {"outlinewidth": 0, "title": {"text": push}},
        }  # fmt: skip
        figures.append({"data": [heat], "layout": axes})
    return figures


def loops(traces: Traces, j: int, stretch: Stretch) -> tuple[Figure, Figure]:
    """Torque beyond the rigid body, measured and of all simulations: over position, over time."""
    return (
        _beyond_body(
            traces, j, stretch, traces.position[:, j], _label(traces, j, *_LABELS["position"])
        ),
        _beyond_body(traces, j, stretch, traces.time, "time [s]"),
    )


def _beyond_body(traces: Traces, j: int, stretch: Stretch, x: FloatArray, label: str) -> Figure:
    all_of, load = stretch.rows, traces.load[:, j]
    rows = slice(all_of.start, all_of.stop, max(1, (all_of.stop - all_of.start) // DRAWN))
    data = [
        drawn
        for name, torque, colour, width in _torques(traces, j, tuple(_SIDES))
        for drawn in _faded(
            x[rows], (torque - load)[rows], traces.moving[rows, j], name, colour, width
        )
    ]
    beyond = _label(traces, j, "torque beyond the rigid body", "N m")
    return {"data": data, "layout": layout(label, beyond)}


def error_over_time(traces: Traces, j: int, recording: int) -> Figure:
    """Recorded less simulated torque of a joint over one recording, before and after."""
    rows = np.flatnonzero(traces.recording == recording)
    rows = rows[:: max(1, len(rows) // DRAWN)]
    data = [drawn for side in _BOTH for drawn in _broken(traces, rows, side, j, *_SIDES[side])]
    return _over_time(data, _label(traces, j, "torque error", "N m"))


def push(
    traces: Traces, recording: int, window: tuple[float, float], names: Sequence[str]
) -> Figure:
    """Residual of the improved simulation on every joint around a push (in time of a recording)."""
    near = (traces.time > window[0] - _AROUND) & (traces.time < window[1] + _AROUND)
    rows = np.flatnonzero(near & (traces.recording == recording))
    data = [
        drawn
        for j, (label, colour) in enumerate(zip(joint_labels(names), cycle(JOINTS)))
        for drawn in _broken(traces, rows, "after", j, label, colour)
    ]
    figure = _over_time(data, f"residual [{unit_of('N m', traces.sliding)}]")
    figure["layout"]["shapes"] = [_shaded(*window, "rgba(138,147,156,0.16)")]
    return figure


def explanations(
    candidates: Sequence[Explanation], names: Sequence[str], chosen: Explanation, most: float
) -> Figure:
    """Odds of the chosen explanation against what else competed, in powers of ten up to `most`."""
    behind = np.array([chosen.log_evidence - item.log_evidence for item in candidates])
    shown = np.clip(behind / np.log(10.0), -most, most)
    bars = {
        "type": "bar", "orientation": "h", "y": list(names),
        "x": numbers(shown),
        "marker": {"color": [AFTER if c is chosen else OTHER for c in candidates]},
        "hovertemplate": "%{y}: 10^%{x} times<extra></extra>",
    }  # fmt: skip
    axes = layout("the chosen one is likelier by [powers of ten]", "")
    axes["xaxis"] |= {"range": [min(0.0, float(shown.min())), most]}
    axes["yaxis"] |= {"autorange": "reversed", "automargin": True, "showgrid": False}
    return {"data": [bars], "layout": axes, "rows": len(names)}


def shifts(moved: Sequence[Shift]) -> Figure:
    """Figure of how far nuisance parameters moved, in standard deviations of their prior."""
    far = [abs(item.sigmas) > 2 for item in moved]  # noqa: PLR2004  # sigma
    dots = {
        "type": "scatter", "mode": "markers", "y": [item.name for item in moved],
        "x": numbers(np.array([item.sigmas for item in moved])),
        "marker": {"color": [BEFORE if f else AFTER for f in far]},
        "text": [f"{s.nominal:.4g} to {s.fitted:.4g} {s.unit}" for s in moved],
        "hovertemplate": "%{y}: %{text}, %{x} sigma<extra></extra>",
    }  # fmt: skip
    axes = layout("moved by [\N{GREEK SMALL LETTER SIGMA}]", "")
    axes["yaxis"] |= {"autorange": "reversed", "automargin": True}
    reach = max(2.5, 1.1 * max((abs(item.sigmas) for item in moved), default=0.0))
    axes["xaxis"] |= {"range": [-reach, reach], "zeroline": True}
    axes["shapes"] = [_shaded(-1, 1, "rgba(11,85,159,0.07)")]
    return {"data": [dots], "layout": axes, "rows": len(moved)}


def replayed(replay: Replay, j: int) -> Figure:
    """Recorded torque of one joint beside both free runs of the simulated robot."""
    return _of_replay(replay, j, _torques(replay, j), _label(replay, j, "torque", "N m"))


def replay_error(replay: Replay, j: int) -> Figure:
    """Recorded torque of one joint less that of both free runs."""
    sides = [(side, *_SIDES[side]) for side in _BOTH]
    curves = [(name, _residual(replay, side, j), colour, LINE) for side, name, colour in sides]
    return _of_replay(replay, j, curves, _label(replay, j, "torque error", "N m"))


def _of_replay(
    replay: Replay, j: int, curves: Sequence[tuple[str, FloatArray, str, float]], label: str
) -> Figure:
    rows = slice(None, None, max(1, len(replay.time) // DRAWN))
    time, moving = replay.time[rows], replay.moving[rows, j]
    data = [
        drawn
        for name, torque, colour, width in curves
        for drawn in _faded(time, torque[rows], moving, name, colour, width)
    ]
    return _over_time(data, label)


def _over_time(data: Sequence[Figure], label: str) -> Figure:
    axes = layout("time [s]", label)
    return {"data": data, "layout": axes | {"showlegend": True}}


def _broken(
    traces: Traces, rows: NDArray[np.intp], side: str, j: int, name: str, colour: str
) -> list[Figure]:
    """Return the residual of a joint over some rows (R,), broken where time leaps."""
    starts = [run.start for run in contiguous_runs(traces)]
    gaps = np.flatnonzero(np.isin(rows[1:], starts)) + 1
    return _faded(
        np.insert(traces.time[rows], gaps, np.nan),
        np.insert(_residual(traces, side, j)[rows], gaps, np.nan),
        np.insert(traces.moving[rows, j], gaps, values=False),
        name,
        colour,
    )


def _residual(traces: Traces | Replay, side: str, j: int) -> FloatArray:
    return traces.measured[:, j] - getattr(traces, side)[:, j]


def _torques(
    traces: Traces | Replay, j: int, sides: Sequence[str] = _BOTH
) -> list[tuple[str, FloatArray, str, float]]:
    simulated = [(_SIDES[side], getattr(traces, side)[:, j]) for side in sides]
    return [
        ("measured", traces.measured[:, j], MEASURED, WIDE),
        *((name, torque, colour, NARROW) for (name, colour), torque in simulated),
    ]


def _end_to_end(traces: Traces) -> FloatArray:
    """Return a time that runs on from one recording to the next, (K,) [s]."""
    shift, end = np.zeros(len(traces.time)), 0.0
    for number in np.unique(traces.recording):
        rows = traces.recording == number
        shift[rows] = end - traces.time[rows][0]
        end += float(np.ptp(traces.time[rows]))
    return traces.time + shift


def _joins(traces: Traces) -> list[float]:
    time = _end_to_end(traces)
    starts = [run.start for run in contiguous_runs(traces)]
    return [float(time[a]) for a in starts[1:] if traces.recording[a] != traces.recording[a - 1]]


def _faded(
    x: FloatArray, y: FloatArray, moving: BoolArray, name: str, colour: str, width: float = LINE
) -> list[Figure]:
    """Return a curve that is pale where the joint is near rest."""
    pale = {"opacity": _FADED, "showlegend": False, "hoverinfo": "skip"}
    return [
        curve(x, y, name, colour, width) | pale,
        curve(x, np.where(moving, y, np.nan), name, colour, width),
    ]


def _band(found: Profile, colour: str) -> Figure:
    """Return the area of one standard deviation to either side, a closed outline for each run."""
    x, high = found.drawn(found.mean + found.spread)
    _, low = found.drawn(found.mean - found.spread)
    ends = np.flatnonzero(np.isnan(x))  # of each run; none where no bin has rows enough
    outlines = [
        np.concatenate([[x[a:b], high[a:b]], [x[a:b][::-1], low[a:b][::-1]], _GAP], axis=1)
        for a, b in zip(np.append(0, ends + 1)[:-1], ends, strict=True)
    ]
    outline = np.concatenate([np.zeros((2, 0)), *outlines], axis=1)
    return {
        "x": numbers(outline[0]),
        "y": numbers(outline[1]),
        "fill": "toself", "fillcolor": _BANDS[colour], "line": {"width": 0}, "mode": "lines",
        "hoverinfo": "skip", "showlegend": False,
    }  # fmt: skip


def _level(y: float) -> Figure:
    return {
        "type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": y, "y1": y,
        "line": {"color": FLOOR, "width": 1, "dash": "dot"},
    }  # fmt: skip


def _shaded(start: float, stop: float, colour: str) -> Figure:
    return {
        "type": "rect", "x0": start, "x1": stop, "y0": 0, "y1": 1, "yref": "paper",
        "layer": "below", "fillcolor": colour, "line": {"width": 0},
    }  # fmt: skip


def _divider(x: float) -> Figure:
    return {
        "type": "line", "x0": x, "x1": x, "y0": 0, "y1": 1, "yref": "paper",
        "line": {"color": "#c9ced4", "width": 1},
    }  # fmt: skip
