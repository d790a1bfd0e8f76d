"""What an evaluation shows: its page, and pictures of torque over time and over position.

Over position, hysteresis shows.
"""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Final

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Ghost, Page, PlayedMotion, arm_view, figures
from limo_driver.pages.markup import columns, folded, grid, header, listed, next_steps, section
from limo_driver.pages.motion import arm_section

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes

    from estimators.evaluation_result import EvaluationResult
    from limo_driver.pages.arm import ArmView
    from limo_driver.pages.markup import Figure as Chart
    from limo_driver.types import FloatArray

_STYLES: Final = (
    (figures.MEASURED, 4.0),
    (figures.BEFORE, 1.4),
    (figures.AFTER, 1.4),
)  # of the torques in their order
_RIGID: Final = "rigid body"
_LEAST: Final = 1e-12  # [N m] of an error that others are compared with
_OPEN: Final = 3  # joints whose curves are seen at once
_ERRORS: Final = (
    "RMSE: root mean square of measured minus predicted torque. Noise floor: what the torque "
    "sensor's noise leaves behind the filter, from the torque's spectrum; unknown where the torque "
    "was filtered before it was recorded. The intervals are right where they hold about 95 % of "
    "the measured torques; on motion unlike what was learned, they are a guess. With what changed: "
    "where offset, friction, gain and interval follow the errors before each row, slowly."
)
_CURVES: Final = (
    "The 6 s in which the joints reverse most often. Grey: measured. Orange: rigid body with "
    "friction. Blue: the model. The torque of the rigid body without friction is taken off all "
    "three, so that what is left is friction and error."
)


def evaluation_page(found: EvaluationResult) -> Page:
    """Return the page of an evaluation."""
    charts = Charts()
    view = _arm(found)
    rigid, model = (float(np.sqrt(side.mean_mse)) for side in (found.rigid_body, found.hybrid))
    seen = ", on motion that it was trained on" if found.trained_on else ""
    unit = unit_of("N m", found.robot.sliding)
    title = (
        f"{found.model[:1].upper()}{found.model[1:]} is {model:.3g} {unit} off the measured "
        f"torque, the rigid body alone {rigid:.3g} {unit} (RMS over joints){seen}{_harmed(found)}."
    )
    of = f" of {found.recording.source}" if found.recording.source else ""
    source = (
        f"{int(found.scored.sum())} samples{of}. Motion and torque pass the same zero-phase filter "
        f"of {found.bandwidth:g} Hz.{_silent(found)}"
    )
    lead = (
        "Drag to turn. The ring around each joint is coloured by the error of the predicted torque "
        f"there, {_measure(found)}: over all samples, or at the moment of the slider."
    )
    body = (
        header(f"Evaluation of {found.model}", title, source)
        + section("Errors", _errors(found, charts), "errors", _ERRORS)
        + arm_section(view, "Where on the arm", lead)
        + section("Friction over time and over position", _curves(found, charts), "curves", _CURVES)
        + _next(found)
    )
    return Page(title, body, charts, view, sliding=found.robot.sliding)


def _harmed(found: EvaluationResult) -> str:
    """Say on how many joints the model does worse than the rigid body alone, if it does on any."""
    names = [
        name
        for name, a, b in zip(
            found.joint_names, found.rigid_body.rmse, found.hybrid.rmse, strict=True
        )
        if b > a
    ]
    if not names:
        return ""
    every = len(names) == len(found.joint_names)
    where = "every joint" if every else f"{len(names)} of {len(found.joint_names)} joints"
    return f"; it is worse than the rigid body on {where}"


def _silent(found: EvaluationResult) -> str:
    """Say of which joints no torque was measured, if there are any."""
    measured = found.recording.measured_joints
    names = [name for name, told in zip(found.joint_names, measured, strict=True) if not told]
    return f" No torque was measured at {', '.join(names)}." if names else ""


def _errors(found: EvaluationResult, charts: Charts) -> str:
    errors = (
        ("noise floor", found.noise_floor, "line-ns-open", figures.FLOOR),
        (_RIGID, found.rigid_body.rmse, "circle-open", figures.BEFORE),
        (found.model, found.hybrid.rmse, "circle", figures.AFTER),
    )
    chart = figures.joint_errors(errors, found.joint_names, unit_of("N m", found.robot.sliding))
    values = dict(found.figures()) | {
        "unlike what was learned": [f"{part:.0%}" for part in found.outside]
    }
    return charts.place(chart, "Error of each joint") + columns(values) + listed(found.changed)


def _arm(found: EvaluationResult) -> ArmView:
    rows = lively_rows(found)
    rows = slice(rows.start, rows.stop, max(1, (rows.stop - rows.start) // figures.DRAWN))
    ghosts = tuple(
        Ghost(name, colour, np.nan_to_num(found.measured - torque)[rows])
        for (name, torque), (colour, _) in zip(torques_of(found), _STYLES, strict=True)
        if colour != figures.MEASURED
    )
    time, position = found.recording.time[rows], found.motion.position[rows]
    said = f"{time[0]:.1f} to {time[-1]:.1f} s of the recording."
    # rings of joints without torque have the colour of no error
    errors = (
        (found.model, tuple(np.nan_to_num(found.hybrid.rmse).tolist())),
        (_RIGID, tuple(np.nan_to_num(found.rigid_body.rmse).tolist())),
    )
    known = _is_known(found)
    largest = float(np.nanmax([found.hybrid.rmse, found.rigid_body.rmse], initial=_LEAST))
    floor = found.noise_floor if known else np.full(len(found.joint_names), largest / 100)
    floor = np.where(found.recording.measured_joints, floor, 0.0)
    beside = {} if known else {"scale": "1 to 100 % of the largest error"}
    return arm_view(
        found.robot,
        position[0],
        errors=errors,
        floor=tuple(floor.tolist()),
        motion=PlayedMotion(time, position, ghosts, caption=said),
        **beside,
    )


def _is_known(found: EvaluationResult) -> bool:
    """Say whether the noise floor of every joint whose torque was measured is known."""
    return bool(np.isfinite(found.noise_floor[found.recording.measured_joints]).all())


def _measure(found: EvaluationResult) -> str:
    """Say what an error is compared with."""
    return (
        "in multiples of its noise floor"
        if _is_known(found)
        else "as a part of the largest one, since the noise floor is unknown"
    )


def _curves(found: EvaluationResult, charts: Charts) -> str:
    order = np.argsort(-found.hybrid.rmse, kind="stable").tolist()
    drawn = [(name, _joint(found, charts, j)) for j in order for name in [found.joint_names[j]]]
    seen = "".join(body for _, body in drawn[:_OPEN])
    return seen + "".join(folded(name, body) for name, body in drawn[_OPEN:])


def _joint(found: EvaluationResult, charts: Charts, j: int) -> str:
    rows = lively_rows(found)
    rows = slice(rows.start, rows.stop, max(1, (rows.stop - rows.start) // figures.DRAWN))
    time, position = found.recording.time[rows], found.motion.position[rows, j]
    over_time: list[Chart] = []
    loops: list[Chart] = []
    for (name, torque), style in zip(torques_of(found), _STYLES, strict=True):
        own = torque[rows, j] - found.frictionless[rows, j]
        over_time.append(figures.curve(time, own, name, *style))
        loops.append(figures.curve(position, own, name, *style))
    friction = f"friction [{found.units[j]}]"
    place = f"position [{unit_of('rad', found.robot.sliding, j)}]"
    drawn = (
        (over_time, figures.layout("time [s]", friction), "Friction over time", True),
        (loops, figures.layout(place, friction), "Friction over position", False),
    )
    return grid(
        charts.place(
            {"data": data, "layout": axes},
            f"{found.joint_names[j]}: {caption}",
            follows=follows,
        )
        for data, axes, caption, follows in drawn
    )


def _next(found: EvaluationResult) -> str:
    steps = [
        (
            "Where the model is far above the noise floor, ask what physics is missing; sim.yaml "
            "is the simulation that it was trained on.",
            "limo diagnose RECORDING --sim sim.yaml --out diagnosis/",
        ),
        (
            "Where it is near, estimate torque live with it.",
            "limo serve --arm NAME --model MODEL_FOLDER",
        ),
    ]
    if found.trained_on:
        steps.insert(
            0,
            (
                "These errors say nothing of other motion: evaluate on a recording that was not "
                "trained on.",
                "limo evaluate OTHER_RECORDING --model MODEL_FOLDER --out evaluation/",
            ),
        )
    return next_steps(steps)


# Okabe and Ito's palette, told apart by any colour vision; lines differ in weight as well.
_MODEL: Final = {"color": "#0072B2", "linewidth": 1.1, "zorder": 3, "linestyle": (0, (4, 1.2))}
_LINES: Final = {
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
            ax.plot(time, torque[rows, j], label=name, **_LINES.get(name, _MODEL))
        ax.set_ylabel(f"$\\tau_{{{j + 1}}}$ [{evaluation.units[j]}]")
        ax.margins(x=0)
        ax.text(
            1.005,
            0.5,
            _rmse_of(evaluation, j),
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
            ax.plot(position, own, label=name, **_LINES.get(name, _MODEL))
        ax.set_title(f"{evaluation.joint_names[j]}  {_rmse_of(evaluation, j)}", fontsize="x-small")
        unit = unit_of("rad", evaluation.robot.sliding, j)
        ax.set_xlabel(f"$q_{{{j + 1}}}$ [{unit}]")
        ax.set_ylabel(f"friction, joint {j + 1} [{evaluation.units[j]}]")
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


def _rmse_of(evaluation: EvaluationResult, j: int) -> str:
    rigid_body, hybrid = evaluation.rigid_body.rmse[j], evaluation.hybrid.rmse[j]
    if not evaluation.recording.measured_joints[j]:
        return "torque not measured"
    return f"RMSE {rigid_body:.3f} → {hybrid:.3f} {evaluation.units[j]}"


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
