"""Picture of an excitation: joint space over time, the flange's path, harmonics, velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.kinematics import KinematicChain
from limopa.picture import DRAWN, EXPLORING_COLOUR, JOINT_COLOURS, STYLE

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.model import RobotModel
    from limopa.exciter import Excitation


def draw(found: Excitation, model: RobotModel, path: Path | str) -> None:
    """Draw an excitation into a file; its ending gives the format (PNG, PDF or SVG).

    Args:
        found: The excitation.
        model: The robot it was found for.
        path: File to write.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(10.0, 7.6), dpi=160, layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.add_gridspec(3, 2, height_ratios=(1.35, 1.0, 1.0), width_ratios=(1.0, 1.3))
        _draw_flange(figure.add_subplot(grid[0, 0], projection="3d"), found, model)
        _draw_harmonics(figure.add_subplot(grid[0, 1]), found)
        _draw_positions(figure.add_subplot(grid[1, :]), found)
        _draw_velocities(figure.add_subplot(grid[2, :]), found, model)
        figure.savefig(str(path))


def _draw_flange(axes: Any, found: Excitation, model: RobotModel) -> None:  # noqa: ANN401  # matplotlib
    from matplotlib.ticker import MaxNLocator

    step = max(1, len(found.trajectory) // DRAWN)
    flange = KinematicChain.of(model).flange_position(found.trajectory.position[::step])
    axes.plot(*flange.T, color=EXPLORING_COLOUR, linewidth=0.6)
    axes.scatter(*flange[0], color=EXPLORING_COLOUR, s=14, label="start and end")
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
            color=_colour(j),
            linewidth=2.0,
            label=f"joint {j + 1}",
        )
    axes.set_title("Harmonics: no two joints share one")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel("amplitude [deg]")
    axes.set_ylim(bottom=0)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _draw_positions(axes: Any, found: Excitation) -> None:  # noqa: ANN401
    motion = found.trajectory
    _draw_joints(axes, found, np.degrees(motion.position))
    axes.set_title(f"Joint space: {motion.duration:g} s, from rest to rest")
    axes.set_ylabel("position [deg]")


def _draw_velocities(axes: Any, found: Excitation, model: RobotModel) -> None:  # noqa: ANN401
    _draw_joints(axes, found, 100 * found.trajectory.velocity / model.limits.velocity)
    axes.set_title("Joint velocity")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("share of the limit [%]")
    axes.set_ylim(-100, 100)


def _draw_joints(axes: Any, found: Excitation, values: Any) -> None:  # noqa: ANN401
    motion = found.trajectory
    step = max(1, len(motion) // DRAWN)
    for j in range(motion.n):
        axes.plot(motion.time[::step], values[::step, j], color=_colour(j), label=f"joint {j + 1}")
    axes.set_xlim(0, motion.duration)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _colour(joint: int) -> str:
    return JOINT_COLOURS[joint % len(JOINT_COLOURS)]
