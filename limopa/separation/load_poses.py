"""Poses in which gravity loads a joint little, much, or from either side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limopa.path import Line

if TYPE_CHECKING:
    from limo_driver.types import FloatArray
    from limopa.separation.chain import MotionChain

_RANGE = 1.25  # [rad] to either side, of a wide sweep
_POSES = 64  # random poses that are looked at
_NEAR, _FAR = 0.7, 1.5  # [rad] of each joint around the start
_LEAST_LOAD = 0.01  # of the torque limit, to either side of a reversal of the load


def range_of(chain: MotionChain, pose: FloatArray, j: int) -> tuple[FloatArray, FloatArray]:
    """Return how far joint j (0-based) can go from a pose to either side, both (n,) [rad]."""
    step = np.eye(len(pose))[j]
    ends: list[FloatArray] = []
    for sign in (-1.0, 1.0):
        reaches = (sign * _RANGE * share for share in np.linspace(1.0, 1.0 / 16, 16))
        free = (r for r in reaches if not chain.broken_by(Line(pose, pose + r * step)))
        ends.append(pose + next(free, 0.0) * step)
    return ends[0], ends[1]


def heavy_and_light(chain: MotionChain, start: FloatArray, j: int) -> list[FloatArray]:
    """Return poses nearby of the lowest and the highest gravity torque at joint j; or none."""
    reachable = _reachable(chain, start, j, _NEAR)
    if not reachable:
        return []
    load = chain.model.gravity_torque(np.array(reachable))[:, j]
    return [reachable[int(load.argmin())], reachable[int(load.argmax())]]


def reversing(chain: MotionChain, j: int) -> tuple[FloatArray, FloatArray] | None:
    """Return the ends of a sweep of joint j that gravity loads from either side; or None.

    Of the sweeps in random poses it is the one whose smaller load is the largest.
    """
    best, found = _LEAST_LOAD * float(chain.model.limits.torque[j]), None
    for spread in (_NEAR, _FAR):
        for pose in _reachable(chain, chain.here, j, spread):
            low, high = range_of(chain, pose, j)
            first, last = chain.model.gravity_torque(np.array([low, high]))[:, j]
            way = Line(chain.here, low)
            if first * last < 0 and min(abs(first), abs(last)) > best and not chain.broken_by(way):
                best, found = min(abs(first), abs(last)), (low, high)
        if found is not None:
            break
    return found


def _reachable(chain: MotionChain, start: FloatArray, j: int, spread: float) -> list[FloatArray]:
    """Return random poses around `start`, with joint j as there, that a straight move reaches."""
    random = np.random.default_rng(0)
    poses = start + random.uniform(-spread, spread, (_POSES, len(start)))
    poses[:, j] = start[j]
    return [pose for pose in poses if not chain.broken_by(Line(start, pose))]
