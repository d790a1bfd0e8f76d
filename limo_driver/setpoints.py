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
    path, speeds = limit_path(target[None], goal, position, velocity, limits, period, hit)
    return path[0], speeds[0]


def limit_path(
    targets: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    limits: JointLimits,
    period: float,
    hit: NDArray[np.bool_],
) -> tuple[FloatArray, FloatArray]:
    """Apply `limit_positions` to one target after the other; (T, n) set-points and velocities."""
    after = np.empty((2, *targets.shape))
    _limit_path(
        targets,
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
def first_unreadable(values: FloatArray, lowest: float) -> int:
    """Return the first joint, from 1, whose value is not finite or below `lowest`; 0 if none."""
    for j in range(values.size):
        if not (lowest <= values[j] < math.inf and values[j] > -math.inf):
            return j + 1
    return 0


@njit(cache=True)
def first_runaway(
    position: FloatArray,
    velocity: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    fastest: FloatArray,
) -> int:
    """Return the first joint, from 1, that is too fast or on its way out of range; 0 if none."""
    for j in range(position.size):
        leaving = position[j] > upper[j] if velocity[j] > 0 else position[j] < lower[j]
        if leaving or abs(velocity[j]) > fastest[j]:
            return j + 1
    return 0


@njit(cache=True)
def _limit_path(
    targets: FloatArray,
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
    """Write the set-points and their velocities into `after`, (2, T, n)."""
    for j in range(goal.size):
        q, v, last = position[j], velocity[j], min(max(goal[j], lower[j]), upper[j])
        change = acceleration[j] * period  # of velocity in one cycle
        for t in range(targets.shape[0]):
            aim = min(max(targets[t, j], lower[j]), upper[j])
            hit[_POSITION] |= aim != targets[t, j]
            high = min(fastest[j], _braking(upper[j] - q, change, period))
            low = -min(fastest[j], _braking(q - lower[j], change, period))
            drift, last = (aim - last) / period, aim
            direct = (aim - q) / period
            if _in_reach(direct, v, drift, low, high, change):
                q, v = aim, direct
            else:
                v = _follow(direct, v, drift, low, high, fastest[j], change, period, hit)
                q += v * period
            after[0, t, j], after[1, t, j] = q, v


@njit(cache=True)
def _in_reach(
    direct: float, velocity: float, drift: float, low: float, high: float, change: float
) -> bool:
    """Say whether the target can be met in this cycle, at a speed that can follow it."""
    most = change * (1 + _ROUNDING)
    return (
        abs(direct - velocity) <= most
        and abs(direct - drift) <= most
        and low * (1 + _ROUNDING) <= direct <= high * (1 + _ROUNDING)
    )


@njit(cache=True)
def _follow(
    direct: float,
    velocity: float,
    drift: float,
    low: float,
    high: float,
    fastest: float,
    change: float,
    period: float,
    hit: NDArray[np.bool_],
) -> float:
    """Return the velocity [rad/s] that catches up with a target out of reach."""
    drift = min(max(drift, -fastest), fastest)
    behind = direct - drift  # [rad/s], to be caught up within one cycle
    catch_up = min(_braking(abs(behind) * period, change, period), abs(behind))
    wanted = drift + math.copysign(catch_up, behind)
    within = min(max(wanted, low), high)
    reached = min(max(within, velocity - change), velocity + change)
    hit[_POSITION] |= within != min(max(wanted, -fastest), fastest)
    hit[_VELOCITY] |= abs(direct) > fastest
    hit[_ACCELERATION] |= reached != within or abs(wanted - direct) > change
    return reached


@njit(cache=True)
def _braking(room: float, change: float, period: float) -> float:
    """Return the highest velocity [rad/s] from which the arm stops within `room` [rad].

    Braking takes `change` off the velocity in each of k further cycles:
    room = period (v + (v - change) + ... + (v - k change)).
    """
    if room <= 0.0:
        return 0.0
    distance = room / period
    k = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * distance / change) - 1.0))
    return distance / (k + 1) + 0.5 * k * change
