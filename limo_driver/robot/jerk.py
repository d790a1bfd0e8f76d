"""Jerk of set-points, where an arm states a limit of it.

What is chosen in each cycle is the change c of the velocity: at most `most`, and no further than
`step` from the one before. A choice is safe if braking from it, by the law below, ends inside the
range and never passes the limit of velocity. After a safe choice the law's own next choice is safe
too, so that there is always one; the one taken is the closest to what leads to the target.

Where there is none, since set-points begin where an arm gave way, too fast for the way left to it,
range and acceleration win: it is braked without regard for its jerk, until it is safe again. An arm
outside its range is safe where it gets no further out.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.robot.setpoints import (
    ACCELERATION,
    JERK,
    POSITION,
    ROUNDING,
    VELOCITY,
    PositionLimits,
    brake_joint,
    braking,
)
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

_FEWEST, _MOST = 2, 12  # halvings of what a cycle may choose from, to find what is chosen
_FINE = 8.0  # halvings of the acceleration that the result is good for
_INSET = 1e-12  # [rad] that a choice keeps from the ends, so that rounding takes no later one away
_LONGEST = 1_000_000  # cycles of braking that are looked ahead, at most


class JerkLimits(PositionLimits):
    """Leads set-points as `PositionLimits` does, within a limit of jerk, too.

    Args:
        limits: Limits of the joints.
        period: Cycle [s].
        jerk: Highest jerk, (n,) [rad/s^3].
    """

    def __init__(self, limits: JointLimits, period: float, jerk: FloatArray) -> None:
        super().__init__(limits, period)
        # What is more than twice the acceleration limits nothing; in numbers that can be summed.
        self._steps = np.minimum(jerk * period * period, 2.0 * self._bounds[3])

    def follow(
        self,
        target: FloatArray,
        goal: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        change: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, int]:
        """Return the next set-point, its velocity, and limits met; see `PositionLimits`."""
        reached, speed = np.empty(target.size), np.empty(target.size)
        before = np.zeros(target.size) if change is None else change
        hit = _follow(
            target, goal, position, velocity, before, self._bounds, self._steps, self._period,
            reached, speed,
        )  # fmt: skip
        return reached, speed, hit

    def follow_path(
        self,
        targets: FloatArray,
        goal: FloatArray,
        position: FloatArray,
        velocity: FloatArray,
        change: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray, int]:
        """Apply `follow` to one target after the other; (T, n) set-points and velocities."""
        path, speeds, hit = np.empty(targets.shape), np.empty(targets.shape), 0
        for t, target in enumerate(targets):
            path[t], speeds[t], met = self.follow(target, goal, position, velocity, change)
            change = speeds[t] - velocity
            goal, position, velocity, hit = target, path[t], speeds[t], hit | met
        return path, speeds, hit

    def brake(
        self, position: FloatArray, velocity: FloatArray, change: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the next set-point on the way to rest, and its velocity; see `PositionLimits`."""
        reached, speed = np.empty(position.size), np.empty(position.size)
        before = np.zeros(position.size) if change is None else change
        _brake(position, velocity, before, self._bounds, self._steps, self._period, reached, speed)
        return reached, speed


@compiled(reads=("target", "goal", "position", "velocity", "before"))
def _follow(
    target: FloatArray,
    goal: FloatArray,
    position: FloatArray,
    velocity: FloatArray,
    before: FloatArray,
    bounds: FloatArray,
    steps: FloatArray,
    period: float,
    reached: FloatArray,
    speed: FloatArray,
) -> int:
    """Write the next set-point into `reached` and `speed`; return the limits met."""
    hit = 0
    for j in range(target.size):
        q, v, c, step = position[j], velocity[j], before[j], steps[j]
        lower, upper, fastest, most = bounds[0, j], bounds[1, j], bounds[2, j], bounds[3, j]
        aim = min(max(target[j], lower), upper)
        last = min(max(goal[j], lower), upper)
        direct, drift = (aim - q) / period, (aim - last) / period
        wanted, near = direct - v, step * (1 + ROUNDING)
        exact = (
            abs(wanted) <= most * (1 + ROUNDING)
            and abs(wanted - c) <= near
            and abs(drift - direct - wanted) <= near  # and it can go on as the target does
            and abs(drift - direct) <= min(most, step) * (1 + ROUNDING)
            and abs(direct) <= fastest * (1 + ROUNDING)
        )
        if exact and _is_safe(q, v, wanted, lower, upper, fastest, most, step, period, _INSET):
            hit |= POSITION if aim != target[j] else 0
            reached[j], speed[j] = aim, direct
            continue
        slower = _braked(v, c, most, step)
        if not _is_safe(q, v, slower, lower, upper, fastest, most, step, period, 0.0):
            brake_joint(j, q, v, bounds, period, reached, speed)
            hit |= POSITION | ACCELERATION
            continue
        drift = min(max(drift, -fastest), fastest)
        wanted = _led(q, v, c, aim, drift, most, step, period)
        # On the way from braking to there, the last that is safe.
        share, lowest, highest = 1.0, 0.0, 1.0
        if not _is_safe(q, v, wanted, lower, upper, fastest, most, step, period, _INSET):
            for _ in range(_halvings(most, step)):
                share = 0.5 * (lowest + highest)
                choice = slower + share * (wanted - slower)
                if _is_safe(q, v, choice, lower, upper, fastest, most, step, period, _INSET):
                    lowest = share
                else:
                    highest = share
            share = lowest
        v += slower + share * (wanted - slower)
        reached[j], speed[j] = q + v * period, v
        hit |= POSITION if aim != target[j] else 0
        hit |= VELOCITY if abs(direct) > fastest else 0
        hit |= ACCELERATION if abs(direct - velocity[j]) > most else 0
        hit |= JERK
    return hit


@compiled(reads=("position", "velocity", "before"))
def _brake(
    position: FloatArray,
    velocity: FloatArray,
    before: FloatArray,
    bounds: FloatArray,
    steps: FloatArray,
    period: float,
    reached: FloatArray,
    speed: FloatArray,
) -> None:
    """Write the next set-point of an arm that brakes to rest, and its velocity."""
    for j in range(position.size):
        q, v, step = position[j], velocity[j], steps[j]
        lower, upper, fastest, most = bounds[0, j], bounds[1, j], bounds[2, j], bounds[3, j]
        slower = _braked(v, before[j], most, step)
        if _is_safe(q, v, slower, lower, upper, fastest, most, step, period, 0.0):
            speed[j] = v + slower
            reached[j] = q + speed[j] * period
        else:
            brake_joint(j, q, v, bounds, period, reached, speed)


@compiled(inline="always")
def _braked(v: float, c: float, most: float, step: float) -> float:
    """Return the next change [rad/s] of an arm that brakes to rest.

    The one from which the changes fade to zero, a step a cycle, as the velocity does; or the
    nearest to it.
    """
    wanted = -math.copysign(braking(abs(v), step, 1.0), v)
    return min(max(min(max(wanted, c - step), c + step), -most), most)


@compiled()
def _rest(
    v: float, c: float, most: float, step: float, period: float
) -> tuple[float, float, float, float]:
    """Brake to rest: return the way [rad] to there, its lowest, its highest, the highest speed."""
    way, lowest, highest, fastest = 0.0, 0.0, 0.0, abs(v)
    for _ in range(_LONGEST):
        if v == 0.0 and abs(c) <= step:
            break
        if abs(c) == most and v * c < 0.0:  # at full deceleration, many cycles are one sum
            cycles = math.floor((abs(v) - _fading(most, step)) / most)
            if cycles > 1:
                way += period * (cycles * v + 0.5 * cycles * (cycles + 1) * c)
                v += cycles * c
        c = _braked(v, c, most, step)
        v += c
        way += v * period
        lowest, highest, fastest = min(lowest, way), max(highest, way), max(fastest, abs(v))
    return way, min(lowest, way), max(highest, way), fastest


@compiled(inline="always")
def _fading(most: float, step: float) -> float:
    """Return the velocity [rad/s] that a change of `most` takes while it fades: most + ... + 0."""
    k = math.floor(most / step)
    return (k + 1) * most - 0.5 * k * (k + 1) * step


@compiled(inline="always")
def _halvings(most: float, step: float) -> int:
    """Return how often to halve: what is small beside the acceleration need not be exact."""
    return int(min(max(_FINE - math.log2(most / step), _FEWEST), _MOST))


@compiled()
def _is_safe(
    q: float,
    v: float,
    c: float,
    lower: float,
    upper: float,
    fastest: float,
    most: float,
    step: float,
    period: float,
    inset: float,
) -> bool:
    """Say whether an arm that takes a change can stop in its range, within its velocity."""
    lower, upper = min(lower, q), max(upper, q)
    v += c
    q += v * period
    _, lowest, highest, speed = _rest(v, c, most, step, period)
    return (
        q + lowest >= lower + inset
        and q + highest <= upper - inset
        and speed <= fastest * (1 + ROUNDING)
    )


@compiled()
def _led(
    q: float, v: float, c: float, aim: float, drift: float, most: float, step: float, period: float
) -> float:
    """Return the change that leads to a target soonest, and from which braking does not pass it.

    In the frame that moves with the target: braking ends at its velocity, `drift`.
    """
    kept = _braked(v - drift, c, most, step)
    side = _short(q, v, kept, aim, drift, most, step, period)
    furthest = min(max(c + math.copysign(step, side), -most), most)
    if side * _short(q, v, furthest, aim, drift, most, step, period) >= 0.0:
        return furthest
    for _ in range(_halvings(most, step)):
        choice = 0.5 * (kept + furthest)
        if side * _short(q, v, choice, aim, drift, most, step, period) >= 0.0:
            kept = choice
        else:
            furthest = choice
    return kept


@compiled()
def _short(
    q: float,
    v: float,
    c: float,
    aim: float,
    drift: float,
    most: float,
    step: float,
    period: float,
) -> float:
    """Return how far short of a moving target braking ends that begins after a change [rad]."""
    v += c
    return aim - (q + v * period) - _rest(v - drift, c, most, step, period)[0]
