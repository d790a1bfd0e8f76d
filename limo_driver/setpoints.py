"""Set-points that keep the limits of the joints: the arithmetic of the safety contract."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numba import njit

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits, WrenchLimits

LIMIT_NAMES = (
    "position", "velocity", "acceleration", "torque", "torque_rate", "wrench", "wrench_rate",
)  # fmt: skip
_POSITION, _VELOCITY, _ACCELERATION, _TORQUE, _TORQUE_RATE = 1, 2, 4, 8, 16  # bits of a hit
_WRENCH, _WRENCH_RATE = 32, 64
_ROUNDING = 1e-6  # relative; a set-point this close to a limit keeps it


def names_of(hit: int) -> tuple[str, ...]:
    """Return the names of the limits whose bits are set."""
    return tuple(name for k, name in enumerate(LIMIT_NAMES) if hit >> k & 1)


def limit_positions(
    target: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    limits: JointLimits,
    period: float,
) -> tuple[FloatArray, FloatArray, int]:
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

    Returns:
        The set-point (n,) [rad], its velocity (n,) [rad/s], and the limits that changed the target,
        as bits in the order of `LIMIT_NAMES`.
    """
    path, speeds, hit = limit_path(target[None], goal, position, velocity, limits, period)
    return path[0], speeds[0], hit


def limit_path(
    targets: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    limits: JointLimits,
    period: float,
) -> tuple[FloatArray, FloatArray, int]:
    """Apply `limit_positions` to one target after the other; (T, n) set-points and velocities."""
    after = np.empty((2, *targets.shape))
    hit = _limit_path(
        targets,
        goal,
        position,
        velocity,
        limits.position_min,
        limits.position_max,
        limits.velocity,
        limits.acceleration,
        period,
        after,
    )
    return after[0], after[1], hit


def limit_torques(
    target: FloatArray,
    torque: FloatArray,
    limits: JointLimits,
    period: float,
) -> tuple[FloatArray, int]:
    """Return the next torque towards `target`, (n,) [N m], and the limits met, as bits."""
    reached, most, rate = _limit_effort(target, torque, limits.torque, limits.torque_rate * period)
    return reached, _TORQUE * most | _TORQUE_RATE * rate


def limit_wrench(
    target: FloatArray, wrench: FloatArray, limits: WrenchLimits, period: float
) -> tuple[FloatArray, int]:
    """Return the next wrench towards `target`, (6,) [N, N m], and the limits met, as bits."""
    reached, most, rate = _limit_effort(target, wrench, limits.wrench, limits.rate * period)
    return reached, _WRENCH * most | _WRENCH_RATE * rate


def _limit_effort(
    target: FloatArray, now: FloatArray, most: FloatArray, step: FloatArray
) -> tuple[FloatArray, bool, bool]:
    """Return the next effort, and whether its limit and that of its rate were met."""
    within = np.minimum(np.maximum(target, -most), most)
    reached = np.minimum(np.maximum(within, now - step), now + step)
    return reached, bool(np.any(within != target)), bool(np.any(reached != within))


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
    after: FloatArray,
) -> int:
    """Write the set-points and their velocities into `after`, (2, T, n); return the limits met."""
    hit = 0
    for j in range(goal.size):
        q, v, last = position[j], velocity[j], min(max(goal[j], lower[j]), upper[j])
        change = acceleration[j] * period  # of velocity in one cycle
        far = (fastest[j] + change) ** 2 * period / change  # more than twice what braking takes
        for t in range(targets.shape[0]):
            aim = min(max(targets[t, j], lower[j]), upper[j])
            if aim != targets[t, j]:
                hit |= _POSITION
            if upper[j] - q > far:  # most often: no end of the range is near
                high = fastest[j]
            else:
                high = min(fastest[j], _braking(upper[j] - q, change, period))
            if q - lower[j] > far:
                low = -fastest[j]
            else:
                low = -min(fastest[j], _braking(q - lower[j], change, period))
            drift, last = (aim - last) / period, aim
            direct = (aim - q) / period
            if _in_reach(direct, v, drift, low, high, change):
                q, v = aim, direct
            else:
                v, met = _follow(direct, v, drift, low, high, fastest[j], change, period)
                hit |= met
                q += v * period
            after[0, t, j], after[1, t, j] = q, v
    return hit


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
) -> tuple[float, int]:
    """Return the velocity [rad/s] that catches up with a target out of reach, and limits met."""
    drift = min(max(drift, -fastest), fastest)
    behind = direct - drift  # [rad/s], to be caught up within one cycle
    catch_up = min(_braking(abs(behind) * period, change, period), abs(behind))
    wanted = drift + math.copysign(catch_up, behind)
    within = min(max(wanted, low), high)
    reached = min(max(within, velocity - change), velocity + change)
    hit = 0
    if within != min(max(wanted, -fastest), fastest):
        hit |= _POSITION
    if abs(direct) > fastest:
        hit |= _VELOCITY
    if reached != within or abs(wanted - direct) > change:
        hit |= _ACCELERATION
    return reached, hit


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
