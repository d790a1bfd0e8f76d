"""A motion that is to be made, as pages show it: the arm that plays it, and its joints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages.arm import ArmView, PlayedMotion, arm_view
from limo_driver.pages.arm_section import arm_section
from limo_driver.pages.figures import joint_motion
from limo_driver.pages.markup import Charts, grid

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.trajectory import Trajectory

_ROWS: Final = 3000  # that are played: an hour of them is a file that a phone opens


def planned_motion(
    model: RobotModel, trajectory: Trajectory, charts: Charts
) -> tuple[ArmView, str]:
    """Return the arm that plays a motion, and its place in the page with the joints over time.

    Args:
        model: The robot it was planned for.
        trajectory: The motion.
        charts: Of the page.
    """
    rows = np.unique(np.linspace(0, len(trajectory) - 1, _ROWS).astype(int))
    position = trajectory.position[rows]
    played = PlayedMotion(
        trajectory.time[rows],
        position,
        caption="Orange line: path of the flange.",
        path=KinematicChain.of(model).flange_position(position),
    )
    view = arm_view(model, position[0], motion=played)
    lead = "Drag to turn; the slider, or a click into the chart below, moves the arm."
    drawn = charts.place(
        joint_motion(trajectory, model.joint_names),
        "Joints over time",
        "from where each starts",
        follows=True,
    )
    return view, arm_section(view, "The motion", lead) + grid([drawn], "one")
