"""Charts of pages as plotly figures: axes, curves and colours that all pages have alike.

Curves of any columns over one time: thinned where they are long, with what is marked in them.
"""

from __future__ import annotations

import gzip
import math
from base64 import b64encode
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.model.units import unit_of
from limo_driver.quoting import in_line
from limo_driver.recordings.gate.held_values import contiguous
from limo_driver.runtime.display import joint_labels

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.pages.markup import Figure
    from limo_driver.trajectory import Trajectory
    from limo_driver.types import FloatArray

MEASURED, BEFORE, AFTER, FLOOR = "#868f98", "#d9730d", "#0b559f", "#868f98"
OTHER: Final = "#75899d"  # what is neither before nor after
# Of joints: none of the colours that tell simulations apart.
JOINTS: Final = ("#2e7d32", "#6a3d9a", "#00838f", "#8c564b", "#c1272d", "#7a8a00", "#66707a")
WIDE, LINE, NARROW = (
    4.0,
    1.8,
    1.4,
)  # lines: of what was measured, of others, of what is laid over it
_MARK, _EDGE = 12, 2  # [px]
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


def curve(x: FloatArray, y: FloatArray, name: str, colour: str, width: float = LINE) -> Figure:
    """Return a line through points x (K,), y (K,); it is broken where either is NaN."""
    return {
        "x": numbers(x, 6), "y": numbers(y, 5), "mode": "lines", "name": name,
        "line": {"color": colour, "width": width},
    }  # fmt: skip


def joint_errors(
    sides: Sequence[tuple[str, FloatArray | Sequence[float], str, str]],
    names: Sequence[str],
    unit: str,
    title: str = "RMSE",
) -> Figure:
    """Return the errors of each joint on a logarithmic axis, one row a joint.

    Args:
        sides: Name, values of the joints (n,), symbol and colour; NaN where a value is not known.
        names: Of the joints.
        unit: Of the errors.
        title: What they are.
    """
    known = [side for side in sides if np.isfinite(side[1]).any()]
    axes = layout(f"{title} [{unit}], logarithmic", "")
    ticks = rounded_ticks(np.concatenate([values for _, values, _, _ in known] or [[]]))
    axes["xaxis"] |= {"type": "log"} | ticks
    axes["yaxis"] |= {"autorange": "reversed", "showgrid": False}
    marks = [
        {
            "x": numbers(np.array(values, dtype=float)), "y": list(names), "mode": "markers",
            "name": name,
            "marker": {"symbol": symbol, "color": colour, "size": _MARK, "line": {"width": _EDGE}},
            "hovertemplate": "%{y}, " + name + ": %{x} " + unit + "<extra></extra>",
        }
        for name, values, symbol, colour in known
    ]  # fmt: skip
    return {"data": marks, "layout": axes, "rows": len(names)}


def numbers(values: FloatArray, digits: int = 4) -> list[float | None]:
    """Return plain numbers of few digits, as JSON wants them; what is not finite is None."""
    few = f".{digits}g"
    return [float(format(v, few)) if math.isfinite(v) else None for v in values.tolist()]


def joint_motion(
    trajectory: Trajectory, names: Sequence[str], sliding: Sequence[bool] = ()
) -> Figure:
    """Positions of the joints that move, from where they start, by their names."""
    step = max(1, len(trajectory) // DRAWN)
    moved = trajectory.position[::step] - trajectory.position[0]
    data = [
        curve(trajectory.time[::step], moved[:, j], label, JOINTS[j % len(JOINTS)])
        for j, label in enumerate(joint_labels(names))
        if np.ptp(trajectory.position[:, j]) > _STILL
    ]
    axes = layout("time [s]", f"position from the start [{unit_of('rad', sliding)}]")
    return {"data": data, "layout": axes | {"showlegend": True}}


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


VALUES: Final = 650_000  # of all curves together, so that a page stays below 5 MB
_FEWEST: Final = 400  # points of each, however many there are
_BROKEN: Final = 4  # points between gaps, in the mean, at least
_LEFT_OUT: Final = 2000  # rows that are drawn one by one, of all that were left out
_MARKS: Final = 1000  # gaps at most, the longest


@dataclass(frozen=True)
class Curve:
    """One column of T rows."""

    name: str  # such as `joint 2`
    column: str  # as the log calls it
    axis: str  # which it shares with others, with its unit
    read: str  # what was read from it, or why nothing was
    values: FloatArray  # (T,)
    colour: str = JOINTS[0]
    dash: str = "solid"
    is_drawn: bool = False  # at first


@dataclass(frozen=True)
class LeftOutRows:
    """Rows that are no part of the recording, and why."""

    reason: str
    rows: NDArray[np.int64]


@dataclass(frozen=True)
class Curves:
    """Columns over one time."""

    time: FloatArray  # (T,) [s], or the number of the row
    rows: NDArray[np.int64]  # in use; their times increase
    curves: tuple[Curve, ...]
    left_out: tuple[LeftOutRows, ...] = ()
    cuts: tuple[tuple[int, str], ...] = ()  # first row after each step of the clock, and its size
    pose: tuple[int, ...] = ()  # curves that are the positions of the arm's joints
    axis: str = "time [s]"

    @cached_property
    def gaps(self) -> tuple[tuple[float, float], ...]:
        """From when to when nothing was recorded, the longest of them."""
        used = self.time[self.rows]
        known = self.time[(self.time >= used[:1]) & (self.time <= used[-1:])] if used.size else used
        time = np.unique(known)
        pieces = pairwise(contiguous(time)) if self.axis.endswith("[s]") else ()
        found = [(float(time[a.stop - 1]), float(time[b.start])) for a, b in pieces]
        longest = sorted(found, key=lambda gap: gap[0] - gap[1])[:_MARKS]
        return tuple(sorted(longest))

    def as_values(self) -> dict[str, Any]:
        """Return what the script of a page draws, as plain values."""
        time = self.time[self.rows]
        each = VALUES // max(len(self.curves), 1)
        bins, size = _bins(time, max(_FEWEST, each))
        most = min(_LEFT_OUT, each // 10) // max(len(self.left_out), 1) or 1
        flagged = [(item.reason, row) for item in self.left_out for row in _few(item.rows, most)]
        others = np.array([row for _, row in flagged], dtype=np.int64)
        packed = [bins.times(time).astype("<f8"), self._placed(others).astype("<f8")]
        curves = list[dict[str, Any]]()
        for curve in self.curves:
            known = curve.values[np.isfinite(curve.values)]
            offset = float(known[0]) if known.size else 0.0  # single precision keeps what is left
            for values in (bins.extremes(curve.values[self.rows]), curve.values[others]):
                with np.errstate(over="ignore", invalid="ignore"):  # of what is no measurement
                    packed.append((values - offset).astype("<f4"))
            look = {key: getattr(curve, key) for key in ("axis", "colour", "dash")}
            texts = {key: in_line(getattr(curve, key)) for key in ("name", "column", "read")}
            curves.append(look | texts | {"drawn": curve.is_drawn, "offset": offset})
        cuts = [[*self._around(row), text] for row, text in self.cuts]
        bytes_ = gzip.compress(b"".join(values.tobytes() for values in packed), mtime=0)
        return {
            "curves": curves,
            "points": bins.points,
            "rows": size,
            "flags": [why for why, _ in flagged],
            "gaps": [gap for gap in self.gaps if list(gap) not in [cut[:2] for cut in cuts]],
            "cuts": cuts,
            "pose": self.pose,
            "layout": layout(self.axis, ""),
            "packed": b64encode(bytes_).decode(),
        }

    def _placed(self, rows: NDArray[np.int64]) -> FloatArray:
        """Return the times of rows that were left out; among those in use where they are none."""
        own, used = self.time[rows], self.time[self.rows]
        if not used.size:
            return own
        is_time = (own >= used[0]) & (own <= used[-1])
        return np.where(is_time, own, np.interp(rows, self.rows, used))

    def _around(self, row: int) -> tuple[float, float]:
        """Return the times in use before and from a row on."""
        at = int(np.searchsorted(self.rows, row))
        time = self.time[self.rows]
        return float(time[max(at - 1, 0)]), float(time[min(at, time.size - 1)])


@dataclass(frozen=True)
class _Bins:
    """Bins of rows, of which the least and the most are drawn; a point without value ends a run."""

    starts: NDArray[np.int64]
    stops: NDArray[np.int64]
    ends: NDArray[np.int64]  # bins after which the curve is broken
    is_whole: bool  # a bin is a row

    @property
    def points(self) -> int:
        return self.starts.size * (1 if self.is_whole else 2) + self.ends.size

    def times(self, time: FloatArray) -> FloatArray:
        middle = time[(self.starts + self.stops) // 2]
        return self._placed(time[self.starts], middle, time[self.stops - 1][self.ends])

    def extremes(self, values: FloatArray) -> FloatArray:
        none = np.full(self.ends.size, np.nan)
        if self.is_whole or not self.starts.size:
            return self._placed(values[self.starts], values[self.starts], none)
        with np.errstate(invalid="ignore"):
            low = np.fmin.reduceat(values, self.starts)
            high = np.fmax.reduceat(values, self.starts)
            falls = values[self.starts] > values[self.stops - 1]
        first, second = np.where(falls, high, low), np.where(falls, low, high)
        return self._placed(first, second, none)

    def _placed(self, first: FloatArray, second: FloatArray, end: FloatArray) -> FloatArray:
        both = first if self.is_whole else np.stack([first, second], axis=1).ravel()
        return np.insert(both, (self.ends + 1) * (1 if self.is_whole else 2), end)


def _bins(time: FloatArray, most: int) -> tuple[_Bins, int]:
    """Return bins of increasing times, and of how many rows each is."""
    size = 1 if time.size <= most else -(-2 * time.size // most)
    runs = contiguous(time)
    if len(runs) > most // _BROKEN:  # more gaps than can be seen
        runs = (slice(0, time.size),)
    starts = [np.arange(run.start, run.stop, size) for run in runs]
    stops = [np.minimum(s + size, run.stop) for s, run in zip(starts, runs, strict=True)]
    ends = np.cumsum([s.size for s in starts])[:-1] - 1 if runs else np.zeros(0)
    none = np.zeros(0, dtype=np.int64)
    every = [np.concatenate(x) if x else none for x in (starts, stops)]
    return _Bins(every[0], every[1], ends.astype(np.int64), size == 1), size


def _few(rows: NDArray[np.int64], most: int) -> list[int]:
    return rows[:: max(1, -(-rows.size // most))].tolist()


def curves_section(curves: Curves, stage: str = "") -> str:
    """Return the place in which the script of a page draws curves, and the arm with them.

    Args:
        curves: What is drawn.
        stage: HTML of the arm's stage, where there is one.
    """
    arm = f'<section id="arm" class="arm" aria-label="The arm">{stage}</section>' if stage else ""
    kinds = {"gap": curves.gaps, "swap": curves.cuts, "flagged": curves.left_out}
    texts = {"gap": "nothing recorded", "swap": "clock was set", "flagged": "row left out"}
    marks = "".join(f'<i class="{k}"></i>{texts[k]}' for k, known in kinds.items() if known)
    key = f'<p class="key small">{marks}<span id="finest"></span></p>'
    return _PLACES.format(arm=arm, key=key, kind="look" if stage else "look armless")


_PLACES: Final = (
    '<div class="watch {kind}">{arm}<section class="curves" aria-label="Curves">'
    '<div class="controls player"><button id="play">Play</button>'
    '<select id="speed" aria-label="Speed of playback"><option value="0.2">0.2 times</option>'
    '<option value="1" selected>real time</option><option value="5">5 times</option>'
    '<option value="60">60 times</option></select>'
    '<input id="when" type="range" step="any" aria-label="Time of the cursor"><output id="at">'
    '</output><button id="in" aria-label="Zoom in at the cursor">+</button>'
    '<button id="out" aria-label="Zoom out">\N{MINUS SIGN}</button>'
    '<button id="whole">Whole</button></div>'
    '<div id="plot" role="img" aria-label="The chosen columns over time"></div>{key}'
    '</section><section class="facts" aria-label="Columns"><div class="controls">'
    '<input id="filter" type="search" aria-label="Filter columns by words of their names" '
    'placeholder="filter: torque 2"><button id="only">Draw only these</button>'
    '<button id="none">None</button></div><div id="columns" class="scroll"></div></section></div>'
)
