"""Torques, wrenches and gains that keep the limits of the joints, from one cycle to the next."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from limo_driver.robot.setpoints import GAIN_RATE, TORQUE
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

GAIN_TIME = 0.1  # [s] in which a gain gets from nothing to the highest that makes sense
FINEST = 1e-3  # [rad] away, at which the highest stiffness has the full torque of a joint
SLOWEST = 1e-2  # [rad/s], at which the highest damping has it
_LAST_DIGITS = 1e-9  # relative, of a step


class EffortLimits:
    """Leads torques, or a wrench, towards what is commanded, within their limits.

    Args:
        most: Highest effort, (n,) [N m] or [N].
        rate: Highest rate, (n,) [N m/s] or [N/s].
        period: Cycle [s].
        bit: Of the limit in `LIMIT_NAMES`, `TORQUE` or `WRENCH`; that of its rate comes after it.
    """

    def __init__(self, most: FloatArray, rate: FloatArray, period: float, bit: int) -> None:
        self._bounds = np.array([most, rate * period])
        self._none = np.zeros(most.size)
        self._bit = bit

    def follow(
        self, target: FloatArray, effort: FloatArray, carried: FloatArray | None = None
    ) -> tuple[FloatArray, int]:
        """Return the effort that comes after `effort` on its way to `target`, and limits met.

        Args:
            target: Commanded, (n,).
            effort: Of the cycle before, (n,).
            carried: What is added to it on its way to the drive, such as gravity, (n,).
        """
        reached = np.empty(target.size)
        added = self._none if carried is None else carried
        return reached, self._bit * _follow_effort(target, effort, added, self._bounds, reached)

    def near(self, target: FloatArray, effort: FloatArray) -> FloatArray:
        """Return what comes closest to `target` after `effort`, within the rate, (n,)."""
        if _is_near(target, effort, self._bounds):
            return target
        return np.clip(target, effort - self._bounds[1], effort + self._bounds[1])

    def fade(self, effort: FloatArray, cycles: int = 1) -> FloatArray:
        """Return what is left of an effort that nobody wants, after some cycles."""
        return np.sign(effort) * np.maximum(np.abs(effort) - cycles * self._bounds[1], 0.0)


class GainLimits:
    """Leads stiffness, damping and feed-forward of an impedance to what is commanded.

    What they change in the torque of a cycle, K (q_set - q) - D dq + tau, keeps the torque's rate,
    and so does the feed-forward alone; the gains have rates of their own.

    Args:
        limits: Limits of the joints.
        period: Cycle [s].
        unseen: By how much a pose that is believed may be false, in position [rad] and velocity
            [rad/s], (2, n): the torque keeps its rate wherever in there the arm is.
    """

    def __init__(
        self, limits: JointLimits, period: float, unseen: FloatArray | None = None
    ) -> None:
        share = period / GAIN_TIME
        most = limits.torque
        stiffer, damper = share * most / FINEST, share * most / SLOWEST
        unseen = np.zeros((2, most.size)) if unseen is None else unseen
        self._bounds = np.array([most, limits.torque_rate * period, stiffer, damper, *unseen])
        self._none = np.zeros(most.size)

    def follow(
        self,
        wanted: tuple[FloatArray, FloatArray, FloatArray],
        before: tuple[FloatArray, FloatArray, FloatArray],
        away: FloatArray,
        velocity: FloatArray,
        carried: FloatArray | None,
        apart: FloatArray | None = None,
    ) -> tuple[tuple[FloatArray, FloatArray, FloatArray], int]:
        """Return stiffness, damping and feed-forward of the next cycle, and the limits met.

        Args:
            wanted: Stiffness [N m/rad], damping [N m s/rad], feed-forward [N m], (n,) each.
            before: Those of the cycle before.
            away: Set-point minus measured position, (n,) [rad].
            velocity: Measured, minus that of the set-point where it is damped, (n,) [rad/s].
            carried: What is added to the torque, such as gravity, (n,) [N m]; None for nothing.
            apart: Where else the arm may be, beyond the measured position, (n,) [rad]: the torque
                keeps its rate there, too.
        """
        reached = np.empty((3, away.size))
        added = self._none if carried is None else carried
        other = away if apart is None else away - apart
        hit = _follow_gains(*wanted, *before, away, other, velocity, added, self._bounds, reached)
        return (reached[0], reached[1], reached[2]), hit

    def effort(
        self,
        gains: tuple[FloatArray, FloatArray, FloatArray],
        away: FloatArray,
        velocity: FloatArray,
    ) -> FloatArray:
        """Return the torque that an impedance has, as far as a drive can make it, (n,) [N m]."""
        stiffness, damping, torque = gains
        most = self._bounds[0]
        return np.clip(stiffness * away - damping * velocity + torque, -most, most)


@compiled(reads=("target", "effort"))
def _is_near(target: FloatArray, effort: FloatArray, bounds: FloatArray) -> bool:
    """Say whether a target is within the rate."""
    for j in range(target.size):  # noqa: SIM110  # compiled
        if not abs(target[j] - effort[j]) <= bounds[1, j]:
            return False
    return True


@compiled(reads=("target", "effort", "carried"))
def _follow_effort(
    target: FloatArray,
    effort: FloatArray,
    carried: FloatArray,
    bounds: FloatArray,
    reached: FloatArray,
) -> int:
    """Write the next effort; return 1 if the limit was met, plus 2 if that of its rate was."""
    hit = 0
    for j in range(target.size):
        most, step, extra = bounds[0, j], bounds[1, j], carried[j]
        within = min(max(target[j], -most - extra), most - extra)
        reached[j] = min(max(within, effort[j] - step), effort[j] + step)
        hit |= (within != target[j]) | (reached[j] != within) << 1
    return hit


@compiled(
    reads=(
        "stiffness", "damping", "torque", "stiffness_0", "damping_0", "torque_0", "away", "other",
        "velocity", "carried",
    )
)  # fmt: skip
def _follow_gains(
    stiffness: FloatArray,
    damping: FloatArray,
    torque: FloatArray,
    stiffness_0: FloatArray,
    damping_0: FloatArray,
    torque_0: FloatArray,
    away: FloatArray,
    other: FloatArray,
    velocity: FloatArray,
    carried: FloatArray,
    bounds: FloatArray,
    reached: FloatArray,
) -> int:
    """Write the next stiffness, damping and feed-forward; return the bits of the limits met."""
    hit = 0
    for j in range(away.size):
        most, step, stiffer, damper = bounds[0, j], bounds[1, j], bounds[2, j], bounds[3, j]
        e, v = away[j], velocity[j]
        k0, d0, t0 = stiffness_0[j], damping_0[j], torque_0[j]
        k = min(max(stiffness[j], k0 - stiffer), k0 + stiffer)
        d = min(max(damping[j], d0 - damper), d0 + damper)
        if k != stiffness[j] or d != damping[j]:
            hit |= GAIN_RATE
        low, high = -most - carried[j], most - carried[j]
        spring, kept = k0 * e - d0 * v, min(max(t0, low), high)
        if kept != t0:
            # More than a drive can be told, as where a spring begins anew: the same torque comes
            # from less stiffness and damping.
            share = min(max((spring + t0 - kept) / spring, 0.0), 1.0) if spring != 0.0 else 0.0
            k0, d0, t0 = share * k0, share * d0, kept
        within = min(max(torque[j], low), high)
        if within != torque[j]:
            hit |= TORQUE
        t = min(max(within, t0 - step), t0 + step)
        if t != within:
            hit |= TORQUE << 1
        # A drive that is saturated makes no more torque, however stiff it is told to be. What it
        # compensates by itself is within its torque, so that it saturates below twice that.
        share = 1.0
        for distance in (e, other[j]):
            before, after = k0 * distance - d0 * v + t0, k * distance - d * v + t
            now, then = min(max(before, -2 * most), 2 * most), min(max(after, -2 * most), 2 * most)
            change = abs(k - k0) * bounds[4, j] + abs(d - d0) * bounds[5, j] + abs(then - now)
            if change > step * (1 + _LAST_DIGITS):
                part = step / change
                if then != now:
                    part = (now + part * (then - now) - before) / (after - before)
                share = min(share, max(part, 0.0))
                hit |= TORQUE << 1
        reached[0, j] = k0 + share * (k - k0)
        reached[1, j] = d0 + share * (d - d0)
        reached[2, j] = t0 + share * (t - t0)
    return hit
