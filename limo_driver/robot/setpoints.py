"""Set-points that keep the limits of the joints: the arithmetic of the safety contract."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

LIMIT_NAMES = (
    "position", "velocity", "acceleration", "torque", "torque_rate", "wrench", "wrench_rate",
    "gain_rate", "jerk",
)  # fmt: skip
POSITION, VELOCITY, ACCELERATION = 1, 2, 4  # bits of a hit
TORQUE, WRENCH = 8, 32  # each with its rate behind it
GAIN_RATE, JERK = 128, 256
_CYCLES_TO_ACT = 2.0  # from a measurement to the first effect of what is sent in answer
VELOCITY_TOLERANCE = 1.2  # times the velocity limit that a measured velocity may reach
ROUNDING = 1e-6  # relative; a set-point this close to a limit keeps it


def names_of(hit: int) -> tuple[str, ...]:
    """Return the names of the limits whose bits are set."""
    return tuple(name for k, name in enumerate(LIMIT_NAMES) if hit >> k & 1)


class PositionLimits:
    """Leads set-points towards what is commanded, within the limits of the joints.

    A target that moves within the limits is met exactly. Any other is followed as the limits
    allow and met without overshoot once it rests: the set-point brakes in time, relative to the
    target's own velocity, and before the ends of the range.

    Args:
        limits: Limits of the joints.
        period: Cycle [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        change = limits.acceleration * period  # of velocity in one cycle
        # How far the ends of the range have to be for nobody to brake: twice what that takes.
        far = (limits.velocity + change) ** 2 * period / change
        lower, upper = limits.position_min, limits.position_max
        # One array, and not read-only: that is quicker on its way into what is compiled.
        self._bounds = np.array([lower, upper, limits.velocity, change, far])
        self._period = period

    def follow(
        self,
        target: FloatArray,
        goal: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        change: FloatArray | None = None,  # noqa: ARG002  # whose limit others keep
    ) -> tuple[FloatArray, FloatArray, int]:
        """Return the next set-point towards `target` and its velocity.

        Args:
            target: Position commanded now, (n,) [rad].
            goal: Position commanded one cycle before, (n,) [rad].
            position: Set-point of this cycle, (n,) [rad].
            velocity: Its velocity, (n,) [rad/s].
            change: Of that, in the cycle before, (n,) [rad/s]; it counts where jerk is limited.

        Returns:
            The set-point (n,) [rad], its velocity (n,) [rad/s], and the limits that changed the
            target, as bits in the order of `LIMIT_NAMES`.
        """
        reached, speed = np.empty(target.size), np.empty(target.size)
        hit = _follow(target, goal, position, velocity, self._bounds, self._period, reached, speed)
        return reached, speed, hit

    def follow_path(
        self,
        targets: FloatArray,
        goal: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        change: FloatArray | None = None,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray, int]:
        """Apply `follow` to one target after the other; (T, n) set-points and velocities."""
        path, speeds = np.empty(targets.shape), np.empty(targets.shape)
        hit = _follow(
            targets[0], goal, position, velocity, self._bounds, self._period, path[0], speeds[0]
        )
        return path, speeds, hit | _follow_on(targets, self._bounds, self._period, path, speeds)

    def brake(
        self,
        position: FloatArray,
        velocity: FloatArray,
        change: FloatArray | None = None,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray]:
        """Return the next set-point on the way to rest, (n,) [rad], and its velocity [rad/s].

        An end of the range that is too near for the limit of acceleration comes first.
        """
        reached, speed = np.empty(position.size), np.empty(position.size)
        _brake(position, velocity, self._bounds, self._period, reached, speed)
        return reached, speed

    def stoppable(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """Return the velocity closest to `velocity` that keeps the limits, (n,) [rad/s].

        That of the joint, and the highest from which it stops inside its range.
        """
        speed = np.empty(position.size)
        _stoppable(position, velocity, self._bounds, self._period, speed)
        return speed

    def first_beyond(
        self, position: FloatArray, velocity: FloatArray, acceleration: FloatArray
    ) -> int:
        """Return the first joint, from 1, that has to brake now to stop in its range; 0 if none.

        Args:
            position: Measured, (n,) [rad].
            velocity: Measured, (n,) [rad/s].
            acceleration: Of the last cycle, (n,) [rad/s^2]; it may go on until the arm brakes.
        """
        return _first_beyond(position, velocity, acceleration, self._bounds, self._period)


@compiled(reads=("values",))
def first_unreadable(values: FloatArray, lowest: float) -> int:
    """Return the first joint, from 1, whose value is not finite or below `lowest`; 0 if none."""
    for j in range(values.size):
        if not (lowest <= values[j] < math.inf and values[j] > -math.inf):
            return j + 1
    return 0


@compiled(inline="always")
def runs_away(j: int, position: FloatArray, velocity: FloatArray, bounds: FloatArray) -> bool:
    """Say whether a joint, from 0, is too fast or on its way out of range."""
    q, v = position[j], velocity[j]
    leaving = (v > 0 and q > bounds[1, j]) or (v < 0 and q < bounds[0, j])
    return leaving or abs(v) > bounds[2, j]


@compiled(reads=("position", "velocity"))
def first_runaway(position: FloatArray, velocity: FloatArray, bounds: FloatArray) -> int:
    """Return the first joint, from 1, that is too fast or on its way out of range; 0 if none.

    Args:
        position: Measured, (n,) [rad].
        velocity: Measured, (n,) [rad/s].
        bounds: Lower and upper end of the range [rad], and highest speed [rad/s], (3, n).
    """
    for j in range(position.size):
        if runs_away(j, position, velocity, bounds):
            return j + 1
    return 0


@compiled(reads=("target", "goal", "position", "velocity"))
def _follow(
    target: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    bounds: FloatArray,
    period: float,
    reached: FloatArray,
    speed: FloatArray,
) -> int:
    """Write the next set-point into `reached` and `speed`; return the limits met."""
    hit = 0
    for j in range(target.size):
        lower, upper, fastest = bounds[0, j], bounds[1, j], bounds[2, j]
        change, far = bounds[3, j], bounds[4, j]
        q, v = position[j], velocity[j]
        aim = min(max(target[j], lower), upper)
        if aim != target[j]:
            hit |= POSITION
        # Most often, no end of the range is near.
        high = fastest if upper - q > far else min(fastest, braking(upper - q, change, period))
        low = fastest if q - lower > far else min(fastest, braking(q - lower, change, period))
        drift = (aim - min(max(goal[j], lower), upper)) / period
        direct = (aim - q) / period
        if _in_reach(direct, v, drift, -low, high, change):
            reached[j], speed[j] = aim, direct
        else:
            v, met = _catch_up(direct, v, drift, -low, high, fastest, change, period)
            hit |= met
            reached[j], speed[j] = q + v * period, v
    return hit


@compiled(reads=("targets",), nogil=True)
def _follow_on(
    targets: FloatArray, bounds: FloatArray, period: float, path: FloatArray, speeds: FloatArray
) -> int:
    """Write all set-points after the first into `path` and `speeds`, (T, n)."""
    hit = 0
    for t in range(1, targets.shape[0]):
        hit |= _follow(
            targets[t], targets[t - 1], path[t - 1], speeds[t - 1], bounds, period,
            path[t], speeds[t],
        )  # fmt: skip
    return hit


@compiled(reads=("position", "velocity"))
def _brake(
    position: FloatArray,
    velocity: FloatArray,
    bounds: FloatArray,
    period: float,
    reached: FloatArray,
    speed: FloatArray,
) -> None:
    """Write the next set-point of an arm that brakes to rest, and its velocity."""
    for j in range(position.size):
        brake_joint(j, position[j], velocity[j], bounds, period, reached, speed)


@compiled(inline="always")
def brake_joint(
    j: int,
    q: float,
    v: float,
    bounds: FloatArray,
    period: float,
    reached: FloatArray,
    speed: FloatArray,
) -> None:
    """Write the next set-point of a joint, from 0, that brakes to rest, and its velocity."""
    change = bounds[3, j]
    room = bounds[1, j] - q if v > 0 else q - bounds[0, j]
    slower = max(abs(v) - change, 0.0)
    if room <= bounds[4, j]:
        slower = min(slower, braking(room, change, period))
    speed[j] = math.copysign(slower, v) if slower > 0.0 else 0.0
    reached[j] = q + speed[j] * period


@compiled(reads=("position", "velocity"))
def _stoppable(
    position: FloatArray, velocity: FloatArray, bounds: FloatArray, period: float, speed: FloatArray
) -> None:
    """Write the velocities within the limits, of which the range's ends are one."""
    for j in range(position.size):
        v = velocity[j]
        room = bounds[1, j] - position[j] if v > 0 else position[j] - bounds[0, j]
        most = min(bounds[2, j], braking(room, bounds[3, j], period))
        speed[j] = math.copysign(min(abs(v), most), v)


@compiled(reads=("position", "velocity", "acceleration"))
def _first_beyond(
    position: FloatArray,
    velocity: FloatArray,
    acceleration: FloatArray,
    bounds: FloatArray,
    period: float,
) -> int:
    """Return the first joint, from 1, that has to brake now; 0 if none."""
    for j in range(position.size):
        v = velocity[j]
        room = bounds[1, j] - position[j] if v > 0 else position[j] - bounds[0, j]
        # It goes on like this for two cycles before the first set-point that brakes has acted; an
        # arm that gets faster than it may is braked for that.
        more = max(math.copysign(acceleration[j], v * acceleration[j]), 0.0)
        most = max(abs(v), VELOCITY_TOLERANCE * bounds[2, j])
        fast = min(abs(v) + _CYCLES_TO_ACT * more * period, most)
        if v != 0.0 and fast > braking(room - _CYCLES_TO_ACT * fast * period, bounds[3, j], period):
            return j + 1
    return 0


@compiled(inline="always")
def _in_reach(
    direct: float, velocity: float, drift: float, low: float, high: float, change: float
) -> bool:
    """Say whether the target can be met in this cycle, at a speed that can follow it."""
    most = change * (1 + ROUNDING)
    return (
        abs(direct - velocity) <= most
        and abs(direct - drift) <= most
        and low * (1 + ROUNDING) <= direct <= high * (1 + ROUNDING)
    )


@compiled(inline="always")
def _catch_up(
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
    catch_up = min(braking(abs(behind) * period, change, period), abs(behind))
    wanted = drift + math.copysign(catch_up, behind)
    within = min(max(wanted, low), high)
    reached = min(max(within, velocity - change), velocity + change)
    hit = 0
    if within != min(max(wanted, -fastest), fastest):
        hit |= POSITION
    if abs(direct) > fastest:
        hit |= VELOCITY
    if reached != within or abs(wanted - direct) > change:
        hit |= ACCELERATION
    return reached, hit or ACCELERATION  # it brakes for the target, and nothing else was met


@compiled(inline="always")
def braking(room: float, change: float, period: float) -> float:
    """Return the highest velocity [rad/s] from which the arm stops within `room` [rad].

    Braking takes `change` off the velocity in each of k further cycles:
    room = period (v + (v - change) + ... + (v - k change)).
    """
    if room <= 0.0:
        return 0.0
    distance = room / period
    k = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * distance / change) - 1.0))
    return distance / (k + 1) + 0.5 * k * change
