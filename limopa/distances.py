"""Distances between capsules of an arm, and their lowest points, of many configurations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.model.kinematics import forward
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


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
    parent: NDArray[np.int64],
    rotation: FloatArray,
    translation: FloatArray,
    axis: FloatArray,
    joint: NDArray[np.int64],  # (m,), of each capsule; -1 is fixed
    ends: FloatArray,  # (m, 2, 3) [m], in the frame of that joint
    radius: FloatArray,  # (m,) [m]
    pairs: NDArray[np.int64],  # (c, 2), capsules
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
