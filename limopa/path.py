"""A path through poses, and how fast it can be travelled.

Time-parameterisation: move along a path from rest to rest within limits up to the jerk.

ruckig plans the motion of the path parameter s(t), limited in speed, acceleration and jerk so that
every joint keeps its own limits; the path is then evaluated at s(t), and so is followed exactly:

dq   = q' ds
ddq  = q'' ds^2 + q' dds
dddq = q''' ds^3 + 3 q'' ds dds + q' ddds

Moving from waypoint to waypoint instead, each a ruckig motion of all joints, follows the path as
well, but between any two of them the jerk jumps from limit to limit: at 8 ms between waypoints the
acceleration ripples by 0.1 to 0.2 rad/s^2, half a newton metre on the iiwa's first joints, which
would bury the hysteresis that the motion is to show.

Each term is bounded by the largest derivative on the path. The samples are joined by quintics
(`Trajectory.evaluate`), whose jerk is the L2 projection of the true jerk onto quadratics: where the
true jerk steps, the quintic overshoots it, but never by more than the factor `OVERSHOOT`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import ruckig

from limo_driver.errors import ConfigError, PathError
from limo_driver.trajectory import Segment, Trajectory
from limo_driver.types import FloatArray, JointLimits, readonly

OVERSHOOT = 2.18  # Lebesgue constant of the L2 projection onto quadratics (2.1756)
CRUISE = 0.5  # share of acceleration and jerk that the path's curvature may use at full speed
ROUNDING = 1e-9  # relative
_SEEN, _TINY = 2001, 1e-12  # samples of a path of the flange; [m]


class Path(Protocol):
    """Joint position q(s) for 0 <= s <= length."""

    @property
    def length(self) -> float:
        """Largest value of the parameter."""
        ...

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` (0 is the position) with respect to s, (T, n)."""
        ...

    def peaks(self) -> FloatArray:
        """Return bounds of |q'|, |q''| and |q'''| of each joint over the whole path, (3, n)."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight path in joint space, q(s) = start + s (end - start), of length 1."""

    start: FloatArray  # (n,) [rad]
    end: FloatArray  # (n,) [rad]

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", readonly(self.start))
        object.__setattr__(self, "end", readonly(self.end))

    @property
    def length(self) -> float:
        """Largest value of the parameter."""
        return 1.0

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` with respect to s, (T, n) [rad]."""
        step = self.end - self.start
        if order == 0:
            return self.start + s[:, None] * step
        return np.tile(step if order == 1 else 0.0 * step, (len(s), 1))

    def peaks(self) -> FloatArray:
        """Return |q'|, |q''| and |q'''| of each joint, (3, n)."""
        step = np.abs(self.end - self.start)
        return np.stack([step, 0.0 * step, 0.0 * step])


@dataclass(frozen=True)
class JointBounds:
    """Limits of each joint along a path; (n,)."""

    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s^2]
    jerk: FloatArray  # [rad/s^3]

    @classmethod
    def of(
        cls,
        limits: JointLimits,
        period: float,
        velocity: FloatArray | float = 1.0,
        acceleration: FloatArray | float = 1.0,
    ) -> JointBounds:
        """Return shares of the limits, less what quintics between samples may exceed them by.

        With |jerk| <= J and its quintic's <= OVERSHOOT J, their integrals, which agree at both ends
        of a sample period h, differ by at most (1 + OVERSHOOT) J h / 2, and those again by h / 2.

        Args:
            limits: Limits of the joints.
            period: Sample period h [s].
            velocity: Share of the velocity limit, of each joint (n,) or of all.
            acceleration: Share of the acceleration limit.

        Raises:
            ConfigError: The samples are too far apart to keep the limits between them.
        """
        jump = limits.jerk / OVERSHOOT
        loss = (1 + OVERSHOOT) / 2 * jump * period
        bounds = cls(
            velocity=np.minimum(velocity * limits.velocity, limits.velocity - loss * period / 2),
            acceleration=np.minimum(acceleration * limits.acceleration, limits.acceleration - loss),
            jerk=limits.jerk * (1 - ROUNDING),
        )
        if min(bounds.velocity.min(), bounds.acceleration.min()) <= 0:
            raise ConfigError(
                f"sample rate is {1 / period:g} Hz, too low to keep the jerk limits between samples"
            )
        return bounds

    def slowed(
        self, path: Path, ways: Callable[[FloatArray], FloatArray], speed: float
    ) -> JointBounds:
        """Return bounds of velocity under which a tool is no faster along a path.

        Args:
            path: The path.
            ways: How far it moves between successive joint positions (T, n), (T - 1,) [m].
            speed: That it may have [m/s].
        """
        if not np.isfinite(speed):
            return self
        s = np.linspace(0.0, path.length, _SEEN)
        steepest = float(ways(path.derivative(s, 0)).max() / s[1])  # [m] by unit of the parameter
        most = path.peaks()[0] * (speed / max(steepest, _TINY))
        slower = np.where(most > 0, np.minimum(self.velocity, most), self.velocity)
        return replace(self, velocity=slower)


@dataclass(frozen=True)
class TimedPath:
    """Samples of a path at a fixed period, from rest to rest; both ends included."""

    parameter: FloatArray  # (T,), s
    position: FloatArray  # (T, n) [rad]
    velocity: FloatArray  # (T, n) [rad/s]
    acceleration: FloatArray  # (T, n) [rad/s^2]


def retime(path: Path, bounds: JointBounds, period: float) -> TimedPath:
    """Move along `path` within `bounds`, from rest to rest, sampled every `period` seconds.

    Raises:
        PathError: ruckig finds no motion.
    """
    # Limits of ds, dds and ddds under which every joint keeps its bounds
    p1, p2, p3 = path.peaks()
    with np.errstate(divide="ignore"):
        ds = min(
            np.min(bounds.velocity / p1),
            np.min(np.sqrt(CRUISE * bounds.acceleration / p2)),
            np.min(np.cbrt(CRUISE * bounds.jerk / p3)),
        )
        jump = (bounds.jerk - p3 * ds**3) / OVERSHOOT
        dds = min(
            np.min((bounds.acceleration - p2 * ds**2) / p1),
            np.min(jump / 2 / (3 * p2 * ds)),
        )
        ddds = np.min((jump - 3 * p2 * ds * dds) / p1)
    s, ds, dds = _profile(path.length, (float(ds), float(dds), float(ddds)), period)
    first, second = path.derivative(s, 1), path.derivative(s, 2)
    return TimedPath(
        parameter=s,
        position=path.derivative(s, 0),
        velocity=first * ds[:, None],
        acceleration=second * ds[:, None] ** 2 + first * dds[:, None],
    )


def joined(parts: Sequence[tuple[str, TimedPath]], period: float, robot: str) -> Trajectory:
    """Join parts, each named and beginning where the one before has come to rest.

    The sample that two parts share belongs to the first of them.
    """
    paths = [path for _, path in parts]
    skips = [0] + [1] * (len(paths) - 1)
    position, velocity, acceleration = (
        np.concatenate([getattr(p, name)[skip:] for p, skip in zip(paths, skips, strict=True)])
        for name in ("position", "velocity", "acceleration")
    )
    stops = np.cumsum([len(p.parameter) - skip for p, skip in zip(paths, skips, strict=True)])
    bounds = pairwise([0, *stops.tolist()])
    return Trajectory(
        np.arange(stops[-1]) * period,
        position,
        velocity,
        acceleration,
        robot=robot,
        segments=tuple(Segment(kind, *rows) for (kind, _), rows in zip(parts, bounds, strict=True)),
    )


def _profile(
    length: float, limits: tuple[float, float, float], period: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return s, ds and dds every `period` from rest at 0 to rest at `length`, each (T,)."""
    planner = ruckig.Ruckig(1, period)
    request = ruckig.InputParameter(1)
    request.duration_discretization = ruckig.DurationDiscretization.Discrete  # end on a sample
    request.current_position, request.target_position = [0.0], [length]
    request.max_velocity, request.max_acceleration, request.max_jerk = ([x] for x in limits)
    motion = ruckig.Trajectory(1)
    result = planner.calculate(request, motion)
    if result not in {ruckig.Result.Working, ruckig.Result.Finished}:
        raise PathError(f"ruckig finds no motion of length {length:g} within {limits}: {result}")
    time = np.arange(round(motion.duration / period) + 1) * period
    return _evaluate(motion.profiles[0][0], np.minimum(time, motion.duration), length)


def _evaluate(
    profile: Any,  # noqa: ANN401  # ruckig has no stubs
    time: FloatArray,
    length: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate the seven constant-jerk phases of a profile at all times at once."""
    starts = np.concatenate([[0.0], np.cumsum(profile.t)[:-1]])
    phase = np.searchsorted(starts, time, side="right") - 1
    u = time - starts[phase]
    p, v, a, j = (
        np.array(values)[phase] for values in (profile.p, profile.v, profile.a, profile.j)
    )
    s = np.clip(p + u * (v + u * (a / 2 + u * j / 6)), 0.0, length)
    ds, dds = v + u * (a + u * j / 2), a + u * j
    s[-1], ds[-1], dds[-1] = length, 0.0, 0.0  # rest, free of rounding
    return s, ds, dds
