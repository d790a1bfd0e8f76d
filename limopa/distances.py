"""Distances between capsules of an arm, and their lowest points, of many configurations.

Motion where the work is: the poses and the speed of a recording.
"""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.kinematics import KinematicChain, forward
from limo_driver.runtime.compiled import compiled
from limopa.request import EVERYWHERE

if TYPE_CHECKING:
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray, IntArray
    from limopa.request import PlanRequest


@compiled(nogil=True)
def segment_distance(p1: FloatArray, q1: FloatArray, p2: FloatArray, q2: FloatArray) -> float:
    """Return the distance [m] between the segments p1 q1 and p2 q2, each end (3,) [m].

    Source: Ericson, "Real-Time Collision Detection", 2005, section 5.1.9.
    """
    a = e = b = c = f = 0.0
    for k in range(3):
        d1, d2, r = q1[k] - p1[k], q2[k] - p2[k], p1[k] - p2[k]
        a += d1 * d1
        e += d2 * d2
        b += d1 * d2
        c += d1 * r
        f += d2 * r
    s = 0.0
    det = a * e - b * b
    if det > 0.0:  # of segments side by side any point will do, as one by rounding does
        s = min(max((b * f - c * e) / det, 0.0), 1.0)
    t = (b * s + f) / e if e > 0.0 else 0.0
    if t < 0.0 or t > 1.0 or e == 0.0:
        t = min(max(t, 0.0), 1.0)
        s = min(max((b * t - c) / a, 0.0), 1.0) if a > 0.0 else 0.0
    total = 0.0
    for k in range(3):
        gap = p1[k] + s * (q1[k] - p1[k]) - p2[k] - t * (q2[k] - p2[k])
        total += gap * gap
    return float(np.sqrt(total))


@compiled(reads=("position",), nogil=True)
def clearances(
    position: FloatArray,  # (T, n) [rad]
    parent: IntArray,
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    joint: IntArray,  # (m,), of each capsule; -1 is fixed
    ends: FloatArray,  # (m, 2, 3) [m], in the frame of that joint
    radius: FloatArray,  # (m,) [m]
    pairs: IntArray,  # (c, 2), capsules
) -> tuple[FloatArray, FloatArray]:
    """Return gap of each pair (T, c) and lowest point of each capsule (T, m) [m]."""
    T, n = position.shape
    m, c = joint.shape[0], pairs.shape[0]
    gap, lowest = np.empty((T, c)), np.empty((T, m))
    R, p = np.empty((n, 3, 3)), np.empty((n, 3))
    world = ends.copy()
    for t in range(T):
        forward(position[t], parent, rotation, translation, axis, R, p)
        for i in range(m):
            if joint[i] >= 0:
                for end in range(2):
                    for row in range(3):
                        total = p[joint[i], row]
                        for k in range(3):
                            total += R[joint[i], row, k] * ends[i, end, k]
                        world[i, end, row] = total
            lowest[t, i] = min(world[i, 0, 2], world[i, 1, 2]) - radius[i]
        for k in range(c):
            i, j = pairs[k, 0], pairs[k, 1]
            between = segment_distance(world[i, 0], world[i, 1], world[j, 0], world[j, 1])
            gap[t, k] = between - radius[i] - radius[j]
    return gap, lowest


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
