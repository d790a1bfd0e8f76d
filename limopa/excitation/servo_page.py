"""The page of commands for position servos: the arm on its way, and what to do with them."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.pages import Charts, Page
from limo_driver.pages.markup import columns, header, next_steps, section
from limo_driver.pages.motion import planned_motion
from limo_driver.quoting import in_shell
from limopa.page import not_checked, span

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
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
        + section("What each joint does", columns(_joints(found)), "joints")
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


def _joints(found: ServoExcitation) -> dict[str, list[object]]:
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
