"""The page of an excitation: the arm on its way, its joints over time, and how well it excites."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.pages import Charts, Page
from limo_driver.pages.markup import columns, header, section
from limo_driver.pages.motion import planned_motion
from limopa.page import not_checked, play_it, span

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limopa.excitation.search import Excitation


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
