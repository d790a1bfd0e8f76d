"""Pages of motions: the arm on its way, its joints over time, and how much of them it uses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import inf
from pathlib import PurePath

from limo_driver.model import RobotModel
from limo_driver.pages import Charts, Page
from limo_driver.pages.markup import columns, header, listed, next_steps, paragraph, section
from limo_driver.pages.motion import planned_motion
from limo_driver.quoting import in_shell
from limo_driver.runtime.display import joints_called
from limopa.excitation.search import Excitation
from limopa.excitation.servo import ServoExcitation
from limopa.planner import Plan, Statistics, summarise

_LONG = 120.0  # [s], said in minutes from here on
_LEAD = (
    "Covered: part of a joint's range that is visited, in 72 bins a turn. Reversals are those "
    "while exploring; between two of them a joint turns by the median given. Peaks are parts of "
    "the joint's limits."
)
_SHOWN = {
    "ramp": "slow ramps: gain (from sag under gravity), dry friction",
    "steps": "steps: delay, damping, inertia, torque limit",
    "quick": "quick ramps: speed limit",
    "creep": "creeping reversals: backlash, dead band, stiction",
    "hold": "holds: sag under gravity, all joints",
    "together": "all joints together: coupling between joints",
    "way": "between poses",
}


def plan_page(plan: Plan, model: RobotModel, file: str, robot: str) -> Page:
    """Return the page of a plan.

    Args:
        plan: The plan.
        model: The robot it was planned for.
        file: Name of the file that has its motion, for the commands that go on from it.
        robot: The robot, as commands know it.
    """
    charts, summary = Charts(), summarise(plan, model)
    view, motion = planned_motion(model, plan.trajectory, charts)
    title = (
        f"{summary.scaffolds} poses explored in {span(summary.duration)}, with "
        f"{sum(joint.reversals for joint in summary.joints)} reversals of joints and at most "
        f"{max(joint.peak_velocity for joint in summary.joints):.0%} of a velocity limit."
    )
    workspace = plan.request.workspace
    source = (
        f"Seed {plan.seed}; flange in {workspace.in_words}{_pace(plan)}; "
        f"{summary.samples} samples at {plan.request.rate:g} Hz."
    )
    stages = summary.rejections
    names = sorted({name for counts in stages.values() for name in counts})
    values: dict[str, list[object]] = {"condition": list(names)}
    values |= {stage: [counts.get(name, 0) for name in names] for stage, counts in stages.items()}
    drawn = paragraph(f"{summary.candidates} random poses were drawn.", "small")
    body = (
        header(f"Locally isotropic motion of {model.name}", title, source)
        + motion
        + section(
            "What each joint does",
            columns(_joints(summary, joints_called(model.joint_names))),
            "joints",
            _LEAD,
        )
        + section("Poses that were rejected", drawn + columns(values) if names else "", "rejected")
        + not_checked(summary.unchecked_pairs)
        + play_it(file, robot)
    )
    return Page(title, body, charts, view)


def _pace(plan: Plan) -> str:
    speed = plan.request.speed
    return f", at {speed:.3g} m/s at most" if speed < inf else ""


def _joints(summary: Statistics, called: Sequence[str]) -> dict[str, list[object]]:
    return {
        "joint": [called[joint.joint - 1] for joint in summary.joints],
        "covered": [f"{joint.coverage:.0%}" for joint in summary.joints],
        "reversals": [joint.reversals for joint in summary.joints],
        "between them [rad]": [joint.rotation_between_reversals for joint in summary.joints],
        "peak velocity": [f"{joint.peak_velocity:.0%}" for joint in summary.joints],
        "peak acceleration": [f"{joint.peak_acceleration:.0%}" for joint in summary.joints],
        "peak jerk": [f"{joint.peak_jerk:.0%}" for joint in summary.joints],
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
        + section("What each joint does", columns(_excited_joints(found, model)), "joints", lead)
        + not_checked(found.unchecked_pairs)
        + play_it(file, robot)
    )
    return Page(title, body, charts, view)


def _excited_joints(found: Excitation, model: RobotModel) -> dict[str, list[object]]:
    motion, peaks = found.trajectory, found.trajectory.peaks().over(model.limits)
    ends = motion.position.min(axis=0), motion.position.max(axis=0)
    shares = {
        "peak velocity": peaks.velocity,
        "peak acceleration": peaks.acceleration,
        "peak jerk": peaks.jerk,
    }
    return {
        "joint": list(joints_called(model.joint_names)),
        "harmonics": [" ".join(map(str, own)) for own in found.harmonics],
        "from [rad]": [f"{angle:.2f}" for angle in ends[0]],
        "to [rad]": [f"{angle:.2f}" for angle in ends[1]],
        **{name: [f"{part:.0%}" for part in values] for name, values in shares.items()},
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
    poses = found.command[0], found.command.min(axis=0), found.command.max(axis=0)
    names = ("first pose [rad]", "lowest [rad]", "highest [rad]")
    joints: dict[str, list[object]] = {"joint": list(found.joint_names)}
    for name, own in zip(names, poses, strict=True):
        joints[name] = [f"{x:.2f}" for x in own]
    body = (
        header(f"Commands for the servos of {model.name}", title, source)
        + motion
        + section("What each part of the motion shows", columns(_spent(found)), "parts")
        + section("What each joint does", columns(joints), "joints")
        + not_checked(found.unchecked_pairs)
        + _send_them(file, robot, ",".join(motors or model.joint_names))
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


def _send_them(file: str, robot: str, motors: str) -> str:
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


def play_it(file: str, robot: str) -> str:
    """Return how to move an arm along a motion, and what to do with the recording."""
    return next_steps(
        [
            (
                "Move a simulated arm along it, and record; another backend moves a real one.",
                "limo run --backend mujoco --trajectory "
                f"{in_shell(PurePath(file))} --record run.parquet",
            ),
            (
                "Identify inertias and friction from that recording.",
                f"limo identify run.parquet --robot {in_shell(robot)} --out sim.yaml",
            ),
        ]
    )


def not_checked(pairs: Iterable[tuple[str, str]]) -> str:
    """Return the section of links that no collision was looked for between."""
    note = "They touch in every pose; whether they collide is for you to judge."
    named = listed(f"{first} and {second}" for first, second in pairs)
    title = "Links not checked against each other"
    return section(title, paragraph(note, "small") + named, "unchecked") if named else ""


def span(seconds: float) -> str:
    """Say a duration."""
    if seconds < _LONG:
        return f"{seconds:.0f} s"
    minutes = seconds / 60
    return f"{minutes:.0f} min" if minutes >= 10 else f"{minutes:.2g} min"  # noqa: PLR2004
