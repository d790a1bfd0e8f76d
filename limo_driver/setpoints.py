"""Set-points that keep the limits of the joints: the arithmetic of the safety contract."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray, JointLimits

LIMIT_NAMES = ("position", "velocity", "acceleration", "torque", "torque_rate")
_POSITION, _VELOCITY, _ACCELERATION, _TORQUE, _TORQUE_RATE = range(5)
_ROUNDING = 1e-6  # relative; a set-point this close to a limit keeps it


def limit_positions(
    target: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    limits: JointLimits,
    period: float,
    hit: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """Return the next set-point towards `target` and its velocity.

    A target that moves within the limits is met exactly. Any other is followed as the limits
    allow and met without overshoot once it rests: the set-point brakes in time, relative to the
    target's own velocity, and before the ends of the range.

    Args:
        target: Position commanded now, (n,) [rad].
        goal: Position commanded one cycle before, (n,) [rad].
        position: Set-point of this cycle, (n,) [rad].
        velocity: Its velocity, (n,) [rad/s].
        limits: Limits of the joints.
        period: Cycle [s].
        hit: Set true for each limit that changed the target, in the order of `LIMIT_NAMES`.
    """
    after = np.empty((2, target.size))
    _limit_positions(
        target,
        goal,
        position,
        velocity,
        limits.position_min,
        limits.position_max,
        limits.velocity,
        limits.acceleration,
        period,
        hit,
        after,
    )
    return after[0], after[1]


def limit_torques(
    target: FloatArray,
    torque: FloatArray,
    limits: JointLimits,
    period: float,
    hit: NDArray[np.bool_],
) -> FloatArray:
    """Return the next torque towards `target`, (n,) [N m], within torque and torque rate."""
    within = np.minimum(np.maximum(target, -limits.torque), limits.torque)
    step = limits.torque_rate * period
    reached = np.minimum(np.maximum(within, torque - step), torque + step)
    hit[_TORQUE] |= bool(np.any(within != target))
    hit[_TORQUE_RATE] |= bool(np.any(reached != within))
    return reached


def slow_down(
    position: FloatArray, velocity: FloatArray, acceleration: FloatArray, period: float
) -> tuple[FloatArray, FloatArray]:
    """Return the next set-point of an arm that brakes to rest, and its velocity."""
    slower = np.sign(velocity) * np.maximum(np.abs(velocity) - acceleration * period, 0.0)
    return position + slower * period, slower


@njit(cache=True)
def _limit_positions(
    target: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    fastest: FloatArray,
    acceleration: FloatArray,
    period: float,
    hit: NDArray[np.bool_],
    after: FloatArray,
) -> None:
    """Write the next set-point and its velocity into `after`, (2, n)."""
    for j in range(target.size):
        change = acceleration[j] * period  # of velocity in one cycle
        top = fastest[j]
        aim = min(max(target[j], lower[j]), upper[j])
        drift = (aim - min(max(goal[j], lower[j]), upper[j])) / period
        direct = (aim - position[j]) / period
        high = min(top, max(_braking(upper[j] - position[j], change, period), 0.0))
        low = -min(top, max(_braking(position[j] - lower[j], change, period), 0.0))
        if (
            abs(direct - velocity[j]) <= change * (1 + _ROUNDING)
            and abs(direct - drift) <= change * (1 + _ROUNDING)
            and low * (1 + _ROUNDING) <= direct <= high * (1 + _ROUNDING)
        ):
            after[0, j], after[1, j] = aim, direct
            hit[_POSITION] |= aim != target[j]
            continue
        hit[_POSITION] |= aim != target[j]
        hit[_VELOCITY] |= abs(direct) > top
        drift = min(max(drift, -top), top)
        behind = aim - position[j] - drift * period
        wanted = drift + math.copysign(
            min(_braking(abs(behind), change, period), abs(behind) / period), behind
        )
        within = min(max(wanted, low), high)
        hit[_POSITION] |= within != min(max(wanted, -top), top)
        reached = min(max(within, velocity[j] - change), velocity[j] + change)
        hit[_ACCELERATION] |= reached != within or abs(wanted - direct) > change
        after[0, j], after[1, j] = position[j] + reached * period, reached


@njit(cache=True)
def _braking(room: float, change: float, period: float) -> float:
    """Return the highest velocity [rad/s] from which the arm stops within `room` [rad].

    Braking takes `change` off the velocity in every cycle: room = v period + (v - change) period
    + ..., which is v (v + change) period / (2 change).
    """
    if room <= 0.0:
        return 0.0
    return -0.5 * change + math.sqrt(0.25 * change * change + 2.0 * change * room / period)
