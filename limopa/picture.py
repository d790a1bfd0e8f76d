"""Pictures of motions: joint space over time, the path of the flange, velocities."""

from __future__ import annotations

from contextlib import contextmanager
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.model.kinematics import KinematicChain
from limo_driver.runtime.outputs import whole
from limopa.planner import EXPLORING, REACHING, reversal_rows, rotations

if TYPE_CHECKING:
    from collections.abc import Generator

    from limo_driver.model import RobotModel
    from limo_driver.trajectory import Segment, Trajectory
    from limo_driver.types import FloatArray
    from limopa.excitation.search import Excitation
    from limopa.planner import Plan
    from limopa.request import Workspace

EXPLORING_COLOUR, REACHING_COLOUR = "#c1272d", "#9aa0a6"
JOINT_COLOURS = ("#0b559f", "#d9730d", "#2e7d32", "#c1272d", "#6a3d9a", "#8c564b", "#00838f")
SATURATION = 10.0  # [deg] of rotation since a reversal, beyond which the paper clips it
DRAWN = 40_000  # samples drawn of a whole motion: enough for print, and an SVG stays small
BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5)}  # of a legend
STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "grid.color": "#e3e5e8",
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "lines.linewidth": 0.8,
    "svg.hashsalt": "limo",  # the same plan gives the same file
}


def draw(plan: Plan, model: RobotModel, path: Path | str) -> None:
    """Draw a plan into a file; its ending gives the format (PNG, PDF or SVG).

    Args:
        plan: The plan.
        model: The robot it was planned for.
        path: File to write.
    """
    with sheet(path, widths=(1.0, 1.15)) as (figure, grid):
        _draw_flange(figure.add_subplot(grid[0, 0], projection="3d"), plan, model)
        _draw_exploring(figure.add_subplot(grid[0, 1]), plan)
        _draw_joint_space(figure.add_subplot(grid[1, :]), plan)
        _draw_velocities(figure.add_subplot(grid[2, 0]), plan, model)
        _draw_rotations(figure.add_subplot(grid[2, 1]), plan)


@contextmanager
def sheet(path: Path | str, widths: tuple[float, float]) -> Generator[tuple[Any, Any]]:
    """Give a figure and its grid of three rows and two columns, and write it once it is drawn.

    Args:
        path: File to write; its ending gives the format (PNG, PDF or SVG).
        widths: Of the columns, relative.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 7.6), dpi=160, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure, figure.add_gridspec(3, 2, height_ratios=(1.35, 1.0, 1.0), width_ratios=widths)
        with whole(path) as draft:
            figure.savefig(draft, format=Path(path).suffix[1:])


def _draw_flange(axes: Any, plan: Plan, model: RobotModel) -> None:  # noqa: ANN401  # matplotlib
    """Draw the flange's path, as in the upper left of the paper's figure of the training motion."""
    flange = KinematicChain.of(model).flange_position(plan.trajectory.position)
    for segment in plan.trajectory.segments:
        rows = slice(max(segment.start - 1, 0), segment.stop, 1 if len(flange) < DRAWN else 8)
        colour = EXPLORING_COLOUR if segment.kind == EXPLORING else REACHING_COLOUR
        width = 0.8 if segment.kind == EXPLORING else 0.5
        axes.plot(*flange[rows].T, color=colour, linewidth=width)
    _draw_workspace(axes, plan.request.workspace)
    axes.plot([], [], color=EXPLORING_COLOUR, label=EXPLORING)
    axes.plot([], [], color=REACHING_COLOUR, label=REACHING)
    dress_flange(axes)


def dress_flange(axes: Any) -> None:  # noqa: ANN401  # matplotlib
    """Label the axes of a path of the flange, look at it from above, and add the base."""
    from matplotlib.ticker import MaxNLocator

    axes.scatter([0], [0], [0], color="black", s=14, marker="s", label="base")
    axes.set_title("Path of the flange")
    axes.set_xlabel("x [m]", labelpad=-4)
    axes.set_ylabel("y [m]", labelpad=-4)
    axes.set_zlabel("z [m]", labelpad=-4)
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
        axis.set_pane_color((1.0, 1.0, 1.0))
    axes.tick_params(pad=-2, labelsize=7)
    axes.set_aspect("equal", adjustable="box")
    axes.view_init(elev=24, azim=-50)
    axes.legend(loc="upper left", bbox_to_anchor=(-0.25, 0.98))


def _draw_workspace(axes: Any, workspace: Workspace) -> None:  # noqa: ANN401
    """Draw a region, or where the sphere of a workspace meets the base's planes, in its bounds."""
    if not np.isfinite(workspace.radius):
        corners = list(product(*zip(workspace.lower, workspace.upper, strict=True)))
        for one, other in combinations(corners if np.isfinite(corners).all() else (), 2):
            if np.count_nonzero(np.subtract(one, other)) == 1:
                axes.plot(*np.transpose([one, other]), color="black", linewidth=0.7, linestyle=":")
        return
    angle = np.linspace(0, 2 * np.pi, 361)
    circle = workspace.radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle])
    for turned in range(3):
        arc = np.roll(circle, turned, axis=0).T + np.array(workspace.centre)
        outside = (arc < np.array(workspace.lower) - 1e-9) | (
            arc > np.array(workspace.upper) + 1e-9
        )
        arc[outside.any(axis=1)] = np.nan
        label = "effective workspace" if turned == 0 else None
        axes.plot(*arc.T, color="black", linewidth=0.7, linestyle=":", label=label)


def _draw_exploring(axes: Any, plan: Plan) -> None:  # noqa: ANN401
    """Draw the joints of the middle exploring phase about their start, reversals marked."""
    segments = [s for s in plan.trajectory.segments if s.kind == EXPLORING]
    number = len(segments) // 2
    rows = slice(segments[number].start, segments[number].stop)
    time = plan.trajectory.time[rows] - plan.trajectory.time[rows.start]
    position = np.degrees(plan.trajectory.position[rows])
    velocity = plan.trajectory.velocity[rows]
    for j in range(position.shape[1]):
        moved = position[:, j] - position[0, j]
        turns = reversal_rows(velocity[:, j])
        colour = colour_of(j)
        axes.plot(time, moved, color=colour, label=f"joint {j + 1}")
        axes.plot(time[turns], moved[turns], ".", color=colour, markersize=3.5)
    title = f"Exploring phase {number + 1} of {len(segments)}; dots: reversals of rotation"
    labels = {"xlabel": "time in the phase [s]", "ylabel": "rotation from the scaffold [deg]"}
    axes.set(title=title, **labels)
    axes.margins(x=0.01)
    axes.legend(**BESIDE)


def _draw_joint_space(axes: Any, plan: Plan) -> None:  # noqa: ANN401
    """Draw all joints over the whole motion; shaded stretches are exploring phases."""
    motion = plan.trajectory
    step = max(1, len(motion) // DRAWN)
    minutes = motion.time[::step] / 60
    for segment in motion.segments:
        if segment.kind == EXPLORING:
            start, stop = motion.time[[segment.start, segment.stop - 1]] / 60
            axes.axvspan(start, stop, color=EXPLORING_COLOUR, alpha=0.08, linewidth=0)
    for j in range(motion.n):
        position = np.degrees(motion.position[::step, j])
        axes.plot(minutes, position, color=colour_of(j), label=f"joint {j + 1}", linewidth=0.6)
    title = f"Joint space: {len(plan.scaffolds)} scaffolds, {motion.duration / 60:.1f} min"
    axes.set(title=f"{title}; shaded: exploring", xlabel="time [min]", ylabel="position [deg]")
    axes.set_xlim(0, motion.duration / 60)
    axes.legend(**BESIDE)


def _draw_velocities(axes: Any, plan: Plan, model: RobotModel) -> None:  # noqa: ANN401
    """Draw how often which velocity occurs, all joints, relative to their limits."""
    motion = plan.trajectory
    bins = np.linspace(0, 100, 51)
    for kind, colour in ((EXPLORING, EXPLORING_COLOUR), (REACHING, REACHING_COLOUR)):
        rows = _rows(motion.segments, kind)
        if rows.size:
            share = 100 * np.abs(motion.velocity[rows]) / model.limits.velocity
            weights = np.full(share.size, 100 / share.size)
            line = {"histtype": "step", "linewidth": 1.2, "color": colour}
            axes.hist(share.ravel(), bins, weights=weights, label=kind, **line)
    axes.set_yscale("log")
    labels = {"xlabel": "share of the joint's limit [%]", "ylabel": "samples of the phase [%]"}
    axes.set(title="Joint velocity", **labels)
    axes.legend()


def _draw_rotations(axes: Any, plan: Plan) -> None:  # noqa: ANN401
    """Draw how far joints turn between two reversals while exploring."""
    motion = plan.trajectory
    phases = [slice(s.start, s.stop) for s in motion.segments if s.kind == EXPLORING]
    values = [
        np.concatenate([rotations(motion.position[r, j], motion.velocity[r, j]) for r in phases])
        for j in range(motion.n)
    ]
    present = [j for j in range(motion.n) if values[j].size]
    parts = axes.boxplot(
        [np.degrees(values[j]) for j in present],
        positions=[j + 1 for j in present],
        showfliers=False,
        patch_artist=True,
        widths=0.55,
        medianprops={"color": "black"},
    )
    for j, box in zip(present, parts["boxes"], strict=True):
        box.set(facecolor=colour_of(j), alpha=0.6, linewidth=0.5)
    title = "Rotation between reversals, exploring; dotted: 10 deg"
    axes.set(title=title, xlabel="joint", ylabel="rotation [deg]")
    axes.axhline(SATURATION, color="black", linewidth=0.6, linestyle=":")
    axes.set_ylim(bottom=0)


def _rows(segments: tuple[Segment, ...], kind: str) -> Any:  # noqa: ANN401  # (k,) rows
    ranges = [np.arange(s.start, s.stop) for s in segments if s.kind == kind]
    return np.concatenate(ranges) if ranges else np.zeros(0, dtype=np.intp)


def colour_of(joint: int) -> str:
    """Return the colour of a joint (0-based), the same in every picture."""
    return JOINT_COLOURS[joint % len(JOINT_COLOURS)]


def draw_excitation(found: Excitation, model: RobotModel, path: Path | str) -> None:
    """Draw an excitation into a file; its ending gives the format (PNG, PDF or SVG).

    Args:
        found: The excitation.
        model: The robot it was found for.
        path: File to write.
    """
    with sheet(path, widths=(1.0, 1.3)) as (figure, grid):
        _draw_excited_flange(figure.add_subplot(grid[0, 0], projection="3d"), found, model)
        _draw_harmonics(figure.add_subplot(grid[0, 1]), found)
        motion = found.trajectory
        position = figure.add_subplot(grid[1, :])
        _draw_joints(position, motion, np.degrees(motion.position))
        title = f"Joint space: {motion.duration:g} s, from rest to rest"
        position.set(title=title, ylabel="position [deg]")
        velocity = figure.add_subplot(grid[2, :])
        _draw_joints(velocity, motion, 100 * motion.velocity / model.limits.velocity)
        velocity.set(title="Joint velocity", xlabel="time [s]", ylabel="share of the limit [%]")
        velocity.set_ylim(-100, 100)


def _draw_excited_flange(axes: Any, found: Excitation, model: RobotModel) -> None:  # noqa: ANN401  # matplotlib
    step = max(1, len(found.trajectory) // DRAWN)
    flange = KinematicChain.of(model).flange_position(found.trajectory.position[::step])
    axes.plot(*flange.T, color=EXPLORING_COLOUR, linewidth=0.6)
    axes.scatter(*flange[0], color=EXPLORING_COLOUR, s=14, label="start and end")
    dress_flange(axes)


def _draw_harmonics(axes: Any, found: Excitation) -> None:  # noqa: ANN401
    """Draw the amplitude of each harmonic, as the sampled motion shows it."""
    position = np.array(found.trajectory.position[:-1])
    amplitude = 2 * np.abs(np.fft.rfft(position, axis=0)) / len(position)
    for j, own in enumerate(found.harmonics):
        frequency = np.array(own) / found.request.duration
        axes.vlines(
            frequency,
            0.0,
            np.degrees(amplitude[list(own), j]),
            color=colour_of(j),
            linewidth=2.0,
            label=f"joint {j + 1}",
        )
    axes.set(
        title="Harmonics: no two joints share one",
        xlabel="frequency [Hz]",
        ylabel="amplitude [deg]",
    )
    axes.set_ylim(bottom=0)
    axes.legend(**BESIDE)


def _draw_joints(axes: Any, motion: Trajectory, values: FloatArray) -> None:  # noqa: ANN401
    step = max(1, len(motion) // DRAWN)
    for j in range(motion.n):
        axes.plot(
            motion.time[::step], values[::step, j], color=colour_of(j), label=f"joint {j + 1}"
        )
    axes.set_xlim(0, motion.duration)
    axes.legend(**BESIDE)
