"""Motion where the work is: the poses and the speed of a recording."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.kinematics import KinematicChain
from limopa.request import EVERYWHERE

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray
    from limopa.request import PlanRequest

_CELL: Final = np.radians(1.0)  # [rad, m]; poses in the same one count once, so that rest does not
_BASELINE: Final = 0.1  # [s] over which speed is seen, so that noise of encoders is not
_MOST: Final = 0.95  # of the time, the work is no faster
_STILL: Final = 1e-3  # [m/s]
_PROBE: Final = 0.1  # [m] from the flange; a point so far away is not faster, either


def near_work(
    model: RobotModel, request: PlanRequest, work: Recording
) -> tuple[PlanRequest, FloatArray]:
    """Return a request as a recording has it, and the poses to draw around, (K, n) [rad].

    Args:
        model: The robot.
        request: Its workspace gives way unless it is a region; its speed, unless it is finite.
        work: Of that robot.

    Raises:
        ConfigError: The flange stands still, so that there is no speed to plan for.
    """
    if not request.workspace.throughout:
        request = replace(request, workspace=EVERYWHERE)
    if request.speed == inf:
        request = replace(request, speed=_speed(model, work))
    cells = np.round(work.position / _CELL).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return request, work.position[np.sort(first)]


def _speed(model: RobotModel, work: Recording) -> float:
    """Return the speed that a recording keeps below most of the time [m/s]."""
    apart = max(1, round(_BASELINE * work.rate))
    moved = ways(KinematicChain.of(model), work.position, apart)
    speeds = moved / (work.time[apart:] - work.time[:-apart])
    fastest = float(np.quantile(speeds, _MOST)) if speeds.size else 0.0
    if fastest < _STILL:
        raise ConfigError(
            f"the flange stands still in it ({fastest:.2g} m/s), so that it has no speed of work; "
            "say which (`speed`)",
            path=work.source or None,
        )
    return fastest


def ways(chain: KinematicChain, position: FloatArray, apart: int = 1) -> FloatArray:
    """Return how far the flange moves, or a probe on it where that turns, (T - apart,) [m].

    Args:
        chain: Of the arm.
        position: (T, n) [rad].
        apart: Rows from where it is to where it will be.
    """
    points = chain.flange + _PROBE * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    last = chain.joint_poses(position)[:, -1]
    at = points @ last[:, :3, :3].swapaxes(1, 2) + last[:, None, :3, 3]
    moved: FloatArray = np.linalg.norm(at[apart:] - at[:-apart], axis=2).max(axis=1)
    return moved
