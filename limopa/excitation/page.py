"""An excitation shown: its pages, for planned motion and for servos, and its picture."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np

from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages import Charts, Page
from limo_driver.pages.markup import columns, header, next_steps, section
from limo_driver.pages.motion import planned_motion
from limo_driver.quoting import in_shell
from limopa.page import not_checked, play_it, span
from limopa.picture import DRAWN, EXPLORING_COLOUR, colour_of, dress_flange, sheet

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from limo_driver.model import RobotModel
    from limopa.excitation.search import Excitation
    from limopa.excitation.servo import ServoExcitation

_SHOWN = {
    "ramp": "slow ramps: gain (from sag under gravity), dry friction",
    "steps": "steps: delay, damping, inertia, torque limit",
    "quick": "quick ramps: speed limit",
    "creep": "creeping reversals: backlash, dead band, stiction",
    "hold": "holds: sag under gravity, all joints",
    "together": "all joints together: coupling between joints",
    "way": "between poses",
}


def excitation_page(
    found: Excitation, model: RobotModel, condition: float, file: str, robot: str
) -> Page:
    """Return the page of an excitation.

    Args:
        found: The excitation.
        model: The robot it was found for.
        condition: Condition number of the regressor of its base parameters.
        file: Name of the file that has its motion, for the commands that go on from it.
        robot: The robot, as commands know it.
    """
    charts = Charts()
    view, motion = planned_motion(model, found.trajectory, charts)
    title = (
        f"{span(found.trajectory.duration)} of motion that excites inertias and friction with "
        f"condition number {condition:.1f}, from rest to rest."
    )
    source = (
        f"Seed {found.seed}; base frequency {found.request.frequency:.4g} Hz; "
        f"{len(found.trajectory)} samples at {found.request.rate:g} Hz. The condition number is "
        "that of the regressor of the base parameters with Coulomb and viscous friction, in SI "
        "units and unscaled: the smaller, the less noise moves what is identified."
    )
    lead = "Peaks are parts of the joint's limits. No two joints share a harmonic."
    body = (
        header(f"Exciting motion of {model.name}", title, source)
        + motion
        + section("What each joint does", columns(_joints(found, model)), "joints", lead)
        + not_checked(found.unchecked_pairs)
        + play_it(file, robot)
    )
    return Page(title, body, charts, view)


def _joints(found: Excitation, model: RobotModel) -> dict[str, list[object]]:
    motion, limits, peaks = found.trajectory, model.limits, found.trajectory.peaks()
    ends = np.degrees([motion.position.min(axis=0), motion.position.max(axis=0)])
    shares = {
        "peak velocity": peaks.velocity / limits.velocity,
        "peak acceleration": peaks.acceleration / limits.acceleration,
        "peak jerk": peaks.jerk / limits.jerk,
    }
    return {
        "joint": list(range(1, motion.n + 1)),
        "harmonics": [" ".join(map(str, own)) for own in found.harmonics],
        "from [°]": [f"{angle:.0f}" for angle in ends[0]],
        "to [°]": [f"{angle:.0f}" for angle in ends[1]],
        **{name: [f"{part:.0%}" for part in values] for name, values in shares.items()},
    }


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


def servo_page(
    found: ServoExcitation,
    model: RobotModel,
    file: str,
    robot: str,
    motors: Sequence[str] = (),
) -> Page:
    """Return the page of commands for position servos.

    Args:
        found: The commands.
        model: The robot they are for.
        file: Name of the file that has them, for the commands that go on from it.
        robot: The robot, as commands know it.
        motors: Names of its motors, as LeRobot knows them; those of the joints if not given.
    """
    charts = Charts()
    view, motion = planned_motion(model, found.trajectory, charts)
    title = (
        f"{span(found.duration)} of commands at {found.request.rate:g} Hz that identify position "
        "servos without torque."
    )
    source = (
        f"Seed {found.seed}; {len(found.repetitions)} repetitions in different poses, so that what "
        "one identifies can be checked on another. Move the arm slowly to the first pose before "
        "sending the first command."
    )
    body = (
        header(f"Commands for the servos of {model.name}", title, source)
        + motion
        + section("What each part of the motion shows", columns(_spent(found)), "parts")
        + section("What each joint does", columns(_servo_joints(found)), "joints")
        + not_checked(found.unchecked_pairs)
        + _next(file, robot, ",".join(motors or model.joint_names))
    )
    return Page(title, body, charts, view)


def _spent(found: ServoExcitation) -> dict[str, list[object]]:
    rows = dict.fromkeys(_SHOWN, 0)
    for part in found.segments:
        rows[part.kind.split()[0]] += part.stop - part.start
    return {
        "motion": list(_SHOWN.values()),
        "time [s]": [f"{many / found.request.rate:.0f}" for many in rows.values()],
    }


def _servo_joints(found: ServoExcitation) -> dict[str, list[object]]:
    degrees = np.degrees([found.command[0], found.command.min(axis=0), found.command.max(axis=0)])
    names = ("first pose [°]", "lowest [°]", "highest [°]")
    said: dict[str, list[object]] = {"joint": list(found.joint_names)}
    for name, own in zip(names, degrees, strict=True):
        said[name] = [f"{x:.0f}" for x in own]
    return said


def _next(file: str, robot: str, motors: str) -> str:
    play = f"python examples/play_servos.py {in_shell(PurePath(file))}"
    steps = [
        (
            f"Send each row of {file} at its time, and record what the encoders read: columns "
            "time [s], command_1, ..., position_1, ... [rad]. This does it through LeRobot; name "
            "the motors as it does.",
            f"{play} --port /dev/ttyACM0 --motors {in_shell(motors)} --out run.csv",
        ),
        (
            "Find servo gains, friction, backlash and payload from that recording.",
            f"limo diagnose run.csv --robot {in_shell(robot)} --out diagnosis",
        ),
    ]
    if PurePath(robot.partition("#")[0]).suffix.lower() == ".xml":
        rehearsed = (
            "See it first on a simulated arm, by the actuators of the same file.",
            f"{play} --simulate {in_shell(robot)} --out rehearsal.csv",
        )
        steps.insert(0, rehearsed)
    return next_steps(steps)
