"""The page of a plan: the arm on its way, its joints over time, and how much of them it uses."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.pages import Charts, Page
from limo_driver.pages.markup import columns, header, listed, next_steps, paragraph, section
from limo_driver.pages.motion import planned_motion
from limo_driver.quoting import in_shell
from limopa.statistics import summarise

if TYPE_CHECKING:
    from collections.abc import Iterable

    from limo_driver.model import RobotModel
    from limopa.planner import Plan
    from limopa.statistics import Statistics

_LONG = 120.0  # [s], said in minutes from here on
_LEAD = (
    "Covered: part of a joint's range that is visited, in bins of 5°. Reversals are those while "
    "exploring; between two of them a joint turns by the median given. Peaks are parts of the "
    "joint's limits."
)


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
        f"Seed {plan.seed}; flange within {workspace.radius:g} m of the base; "
        f"{summary.samples} samples at {plan.request.rate:g} Hz."
    )
    body = (
        header(f"Locally isotropic motion of {model.name}", title, source)
        + motion
        + section("What each joint does", columns(_joints(summary)), "joints", _LEAD)
        + section("Poses that were rejected", _rejected(summary), "rejected")
        + not_checked(summary.unchecked_pairs)
        + play_it(file, robot)
    )
    return Page(title, body, charts, view)


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


def _joints(summary: Statistics) -> dict[str, list[object]]:
    return {
        "joint": [joint.joint for joint in summary.joints],
        "covered": [f"{joint.coverage:.0%}" for joint in summary.joints],
        "reversals": [joint.reversals for joint in summary.joints],
        "between them [°]": [
            float(np.degrees(joint.rotation_between_reversals)) for joint in summary.joints
        ],
        "peak velocity": [f"{joint.peak_velocity:.0%}" for joint in summary.joints],
        "peak acceleration": [f"{joint.peak_acceleration:.0%}" for joint in summary.joints],
        "peak jerk": [f"{joint.peak_jerk:.0%}" for joint in summary.joints],
    }


def _rejected(summary: Statistics) -> str:
    stages = summary.rejections
    names = sorted({name for counts in stages.values() for name in counts})
    values: dict[str, list[object]] = {"condition": list(names)}
    values |= {stage: [counts.get(name, 0) for name in names] for stage, counts in stages.items()}
    drawn = paragraph(f"{summary.candidates} random poses were drawn.", "small")
    return drawn + columns(values) if names else ""
