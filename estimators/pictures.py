"""Pictures of an evaluation: torque over time, and torque over position, where hysteresis shows."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes

    from estimators.evaluation_result import EvaluationResult
    from limo_driver.types import FloatArray

# Okabe and Ito's palette, told apart by any colour vision; lines differ in weight as well.
_MODEL: Final = {"color": "#0072B2", "linewidth": 1.1, "zorder": 3, "linestyle": (0, (4, 1.2))}
_STYLES: Final = {
    "measured": {"color": "0.65", "linewidth": 2.4, "zorder": 1},
    "rigid body": {"color": "#D55E00", "linewidth": 1.1, "zorder": 2},
}
_WINDOW: Final = 6.0  # [s] shown
_COLUMNS: Final = 4
_POINTS: Final = 4000  # of a line, at most
_DOTS_PER_INCH: Final = 150
_MOVING: Final = 0.01  # [rad/s]; slower, a sign change of the velocity may be noise


def torque_figure(evaluation: EvaluationResult, window: float = _WINDOW) -> Figure:
    """Draw torque over time, one row for each joint, over `window` seconds of lively motion."""
    rows = lively_rows(evaluation, window)
    n = evaluation.measured.shape[1]
    figure = Figure(figsize=(10.0, 1.25 * n + 1.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(figure.subplots(n, 1, sharex=True, squeeze=False)[:, 0])
    time = evaluation.recording.time[rows]
    for j, ax in enumerate(axes):
        for name, torque in torques_of(evaluation):
            ax.plot(time, torque[rows, j], label=name, **_STYLES.get(name, _MODEL))
        ax.set_ylabel(f"$\\tau_{{{j + 1}}}$ [N m]")
        ax.margins(x=0)
        ax.text(
            1.005,
            0.5,
            _figures(evaluation, j),
            transform=ax.transAxes,
            fontsize="x-small",
            va="center",
        )
    axes[-1].set_xlabel("time [s]")
    _finish(figure, axes, evaluation, "Torque over time")
    return figure


def loop_figure(evaluation: EvaluationResult, window: float = _WINDOW) -> Figure:
    """Draw torque over position, one panel for each joint: the hysteresis loops.

    Gravity and inertia would bury the loops of a loaded joint. So the torque of the rigid body
    without friction is taken from all three lines: what is left is the joint's own.
    """
    rows = lively_rows(evaluation, window)
    n = evaluation.measured.shape[1]
    columns = min(_COLUMNS, n)
    figure = Figure(figsize=(3.1 * columns, 2.7 * -(-n // columns) + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(-(-n // columns), columns, squeeze=False).ravel().tolist()
    for j, ax in enumerate(axes[:n]):
        position = evaluation.motion.position[rows, j]
        for name, torque in torques_of(evaluation):
            own = torque[rows, j] - evaluation.frictionless[rows, j]
            ax.plot(np.rad2deg(position), own, label=name, **_STYLES.get(name, _MODEL))
        ax.set_title(f"{evaluation.joint_names[j]}  {_figures(evaluation, j)}", fontsize="x-small")
        ax.set_xlabel(f"$q_{{{j + 1}}}$ [°]")
        ax.set_ylabel(f"friction, joint {j + 1} [N m]")
    for ax in axes[n:]:
        ax.set_visible(False)
    _finish(
        figure, axes[:n], evaluation, "Friction (torque less gravity and inertia) over position"
    )
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=_DOTS_PER_INCH)
    return buffer.getvalue()


def torques_of(evaluation: EvaluationResult) -> Iterator[tuple[str, FloatArray]]:
    """Give the torques that are compared by name, (T, n) [N m] each: the measured one first."""
    yield "measured", evaluation.measured
    yield "rigid body", evaluation.estimate.simulation
    yield evaluation.model, evaluation.estimate.torque


def _figures(evaluation: EvaluationResult, j: int) -> str:
    rigid_body, hybrid = evaluation.rigid_body.rmse[j], evaluation.hybrid.rmse[j]
    if not evaluation.recording.measured_joints[j]:
        return "torque not measured"
    return f"RMSE {rigid_body:.3f} → {hybrid:.3f} N m"


def lively_rows(evaluation: EvaluationResult, window: float = _WINDOW) -> slice:
    """Return the rows of the window in which the joints, together, reverse most often."""
    rate = evaluation.recording.rate
    length = max(2, int(window * rate))
    reversals = np.abs(np.diff(np.sign(evaluation.motion.velocity), axis=0)).sum(axis=1)
    moving = np.abs(evaluation.motion.velocity[1:]).max(axis=1) > _MOVING
    counts = np.cumsum(np.concatenate([[0.0], reversals * moving * evaluation.scored[1:]]))
    best, most = slice(0, 2), -1.0
    for rows in evaluation.recording.segments:
        starts = np.arange(rows.start, max(rows.start + 1, rows.stop - length), int(rate) or 1)
        ends = np.minimum(starts + length, rows.stop) - 1
        found = counts[ends] - counts[starts]
        if found.max() > most:
            most, start = float(found.max()), int(starts[found.argmax()])
            best = slice(start, min(start + length, rows.stop))
    return slice(best.start, best.stop, max(1, (best.stop - best.start) // _POINTS))


def _finish(figure: Figure, axes: Sequence[Axes], evaluation: EvaluationResult, title: str) -> None:
    for ax in axes:
        ax.grid(visible=True, linewidth=0.4, alpha=0.5)
        ax.tick_params(labelsize="x-small")
        ax.spines[["top", "right"]].set_visible(False)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, frameon=False)
    figure.suptitle(
        f"{title} ({evaluation.bandwidth:g} Hz zero-phase low-pass)", x=0.01, ha="left", fontsize=10
    )
