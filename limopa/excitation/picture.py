"""Picture of an excitation: joint space over time, the flange's path, harmonics, velocities."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.model.kinematics import KinematicChain
from limopa.picture import DRAWN, EXPLORING_COLOUR, colour_of, dress_flange, sheet

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.model import RobotModel
    from limopa.excitation.search import Excitation


def draw(found: Excitation, model: RobotModel, path: Path | str) -> None:
    """Draw an excitation into a file; its ending gives the format (PNG, PDF or SVG).

    Args:
        found: The excitation.
        model: The robot it was found for.
        path: File to write.
    """
    with sheet(path, widths=(1.0, 1.3)) as (figure, grid):
        _draw_flange(figure.add_subplot(grid[0, 0], projection="3d"), found, model)
        _draw_harmonics(figure.add_subplot(grid[0, 1]), found)
        _draw_positions(figure.add_subplot(grid[1, :]), found)
        _draw_velocities(figure.add_subplot(grid[2, :]), found, model)


def _draw_flange(axes: Any, found: Excitation, model: RobotModel) -> None:  # noqa: ANN401  # matplotlib
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
        axes.plot(
            motion.time[::step], values[::step, j], color=colour_of(j), label=f"joint {j + 1}"
        )
    axes.set_xlim(0, motion.duration)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
