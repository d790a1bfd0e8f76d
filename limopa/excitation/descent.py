"""A motion on its way to the least condition number: one descent after the other.

Fourier series that start and end at rest, each joint on harmonics of its own.

q_j(t) = p_j + sum_h (a_jh sin(h w t) + b_jh cos(h w t)),  w = 2 pi / duration

over one period. The coefficients are those, of the harmonics h of joint j, for which velocity and
acceleration vanish where the period begins, and so where it ends: no window, no polynomial that
would spread the motion over other frequencies.

Source: Swevers, Ganseman, Tükel, De Schutter and Van Brussel, "Optimal robot excitation and
identification", IEEE Trans. Robotics and Automation 1997; Çallar and Böttger, "Hybrid Learning of
Time-Series Inverse Dynamics Models for Locally Isotropic Robot Motion", RA-L 2022, sec. III-A
(joint-wise disjunct).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np
from scipy.linalg import null_space
from scipy.optimize import OptimizeResult, minimize

from limo_driver.types import FloatArray, JointLimits, Motion
from limopa.path import OVERSHOOT

if TYPE_CHECKING:
    from collections.abc import Callable

    from limopa.feasibility import Feasibility

_MEMORY = 20  # steps that L-BFGS remembers
Harmonics: TypeAlias = tuple[tuple[int, ...], ...]  # of each joint, multiples of 1 / duration
ORDERS = 4  # position, velocity, acceleration, jerk
_SHARE = 0.98  # of the limits of velocity and acceleration
_UNIT = 0.1  # [m] too near that counts as much as twice the velocity limit
_STEP = 1e-6  # [rad] of finite differences


class Sensitivity(Protocol):
    """A smooth value of a motion and its derivative by the motion's samples, each (T, n)."""

    @property
    def value(self) -> float:
        """The value, to be made small."""
        ...

    @property
    def position(self) -> FloatArray:
        """Derivative by the positions."""
        ...

    @property
    def velocity(self) -> FloatArray:
        """Derivative by the velocities."""
        ...

    @property
    def acceleration(self) -> FloatArray:
        """Derivative by the accelerations."""
        ...


class Criterion(Protocol):
    """Objective that the motion minimises: a condition number."""

    def condition(self, motion: Motion) -> float:
        """Return the condition number."""
        ...

    def smooth(self, motion: Motion, sharpness: float) -> Sensitivity:
        """Return a smooth bound of its logarithm, the closer the greater `sharpness`."""
        ...


@dataclass(frozen=True)
class EvaluatedMotion:
    """A motion, and all that its value depends on."""

    fourier: Fourier
    time: FloatArray  # [s] of the samples that the criterion sees
    coarse: Sampled  # at these
    dense: Sampled  # where limits are looked at
    criterion: Criterion
    excess: Excess
    x: FloatArray
    value: float = inf

    def refined(
        self, sharpness: float, weight: float, iterations: int, watch: IterationProgress
    ) -> EvaluatedMotion:
        """Return the motion after a descent.

        Args:
            sharpness: Of the smooth bound of the condition number.
            weight: Of what exceeds a limit.
            iterations: At most; with 0, only the value changes.
            watch: Told of each.
        """

        def value(x: FloatArray) -> tuple[float, FloatArray]:
            wanted = self.criterion.smooth(self._motion(x), sharpness)
            over = self.excess.of(self.dense.states(x))
            by = np.stack(
                [wanted.position, wanted.velocity, wanted.acceleration, 0.0 * wanted.position]
            )
            slope = self.coarse.slope(by) + weight * self.dense.slope(over.states)
            return wanted.value + weight * over.value, slope

        if not iterations:
            return replace(self, value=value(self.x)[0])

        def report(intermediate_result: OptimizeResult) -> None:
            watch.step(self.criterion.condition(self._motion(intermediate_result.x)))

        options = {"maxiter": iterations, "maxcor": _MEMORY}
        found = minimize(
            value, self.x, jac=True, method="L-BFGS-B", options=options, callback=report
        )
        watch.end_stage(iterations)
        return replace(self, x=found.x, value=float(found.fun))

    def _motion(self, x: FloatArray) -> Motion:
        return Motion(self.time, *self.coarse.states(x)[:3])


class IterationProgress:
    """Count iterations and tell of them."""

    def __init__(self, tell: Callable[[int, int, float], None], most: int) -> None:
        self._tell, self._most = tell, most
        self._done = self._ended = 0
        self._condition = inf

    def step(self, condition: float) -> None:
        """Count an iteration that led to a condition number."""
        self._done, self._condition = self._done + 1, condition
        self._tell(min(self._done, self._most), self._most, condition)

    def end_stage(self, iterations: int) -> None:
        """Count what a stage had left, which may have come to its minimum early."""
        self._ended += iterations
        self._done = self._ended
        self._tell(self._done, self._most, self._condition)


@dataclass(frozen=True)
class Fourier:
    """All Fourier motions of n joints on given harmonics; they are linear in x.

    x is the pose p, (n,) [rad], then for each joint what its motion is made of, each entry of the
    size that the limits allow: 2 K - 2 of them for K harmonics.
    """

    harmonics: Harmonics
    duration: float  # [s]
    shapes: tuple[FloatArray, ...]  # of each joint, (2 K, 2 K - 2) [rad]: sines, then cosines

    @classmethod
    def of(cls, harmonics: Harmonics, duration: float, limits: JointLimits) -> Fourier:
        """Return the motions on some harmonics, two or more of each joint."""
        shapes: list[FloatArray] = []
        for j, own in enumerate(harmonics):
            w = 2 * np.pi * np.array(own) / duration
            reach = (limits.position_max[j] - limits.position_min[j]) / 2
            size = np.minimum(
                np.minimum(reach, limits.velocity[j] / w), limits.acceleration[j] / w**2
            )
            zero = np.zeros_like(w)
            rest = np.array([[*(size * w), *zero], [*zero, *(size * w**2)]])
            free = null_space(rest / np.linalg.norm(rest, axis=1, keepdims=True))
            shapes.append(np.concatenate([size, size])[:, None] * free)
        return cls(harmonics, duration, tuple(shapes))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.harmonics)

    @property
    def size(self) -> int:
        """Number of entries of x."""
        return self.n + sum(shape.shape[1] for shape in self.shapes)

    def sampled(self, time: FloatArray) -> Sampled:
        """Return the motions at `time` [s], (T,)."""
        return Sampled(self.n, tuple(self._basis(time, order) for order in range(ORDERS)))

    def scaled(self, x: FloatArray, amplitude: float) -> FloatArray:
        """Return the same motion around the same pose with a share of its amplitude."""
        return np.concatenate([x[: self.n], amplitude * x[self.n :]])

    def _basis(self, time: FloatArray, order: int) -> tuple[FloatArray, ...]:
        """Return what each joint's entries of x add to a derivative by time, (T, 2 K - 2)."""
        found: list[FloatArray] = []
        for own, shape in zip(self.harmonics, self.shapes, strict=True):
            w = 2 * np.pi * np.array(own) / self.duration
            angle = np.outer(time, w) + order * np.pi / 2  # by which a derivative leads
            waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)
            found.append(waves * np.tile(w**order, 2) @ shape)
        return tuple(found)


@dataclass(frozen=True)
class Sampled:
    """All Fourier motions on given harmonics, at T given times."""

    n: int
    basis: tuple[tuple[FloatArray, ...], ...]  # of each order and joint, (T, 2 K - 2)

    def states(self, x: FloatArray) -> FloatArray:
        """Return position, velocity, acceleration and jerk, (4, T, n) [rad, s]."""
        ends = np.cumsum([B.shape[1] for B in self.basis[0]])
        parts = np.split(x[self.n :], ends[:-1].tolist())
        states = np.array(
            [
                np.stack([B @ part for B, part in zip(order, parts, strict=True)], axis=1)
                for order in self.basis
            ]
        )
        states[0] += x[: self.n]
        return states

    def slope(self, states: FloatArray) -> FloatArray:
        """Return the derivative by x of a value from that by the states, (4, T, n)."""
        own = [
            np.sum([order[j].T @ by[:, j] for order, by in zip(self.basis, states, strict=True)], 0)
            for j in range(self.n)
        ]
        return np.concatenate([states[0].sum(axis=0), *own])


def allot(n: int, count: int, random: np.random.Generator) -> Harmonics:
    """Give each of n joints `count` of the first n `count` harmonics, at random.

    Each joint gets one of the first n, one of the next n, and so on: something slow to go far, and
    something fast to accelerate.
    """
    bands = [random.permutation(n) + 1 + band * n for band in range(count)]
    return tuple(tuple(int(band[j]) for band in bands) for j in range(n))


@dataclass(frozen=True)
class StateGradient:
    """A value and its derivative by the states, (4, T, n)."""

    value: float
    states: FloatArray


class Excess:
    """The mean square of what exceeds a limit, relative to the limit.

    Limits are those of joint position, velocity, acceleration and jerk, and the distances of
    `Feasibility.margins`. The jerk keeps off its limit by what quintics between samples overshoot.

    Args:
        limits: Of the joints.
        feasibility: Range of the joints, and distances.
    """

    def __init__(self, limits: JointLimits, feasibility: Feasibility) -> None:
        self.feasibility = feasibility
        lower, upper = feasibility.lower, feasibility.upper
        self._middle = (lower + upper) / 2
        self._bounds = np.stack(
            [
                (upper - lower) / 2,
                _SHARE * limits.velocity,
                _SHARE * limits.acceleration,
                limits.jerk / OVERSHOOT,
            ]
        )[:, None]  # (4, 1, n)

    def of(self, states: FloatArray) -> StateGradient:
        """Return the excess of position, velocity, acceleration and jerk, (4, T, n)."""
        T = states.shape[1]
        relative = states / self._bounds
        relative[0] -= self._middle / self._bounds[0]
        over = np.maximum(np.abs(relative) - 1.0, 0.0)
        slope = 2 * over * np.sign(relative) / self._bounds
        near = self._near(states[0], slope[0])
        return StateGradient((float((over**2).sum()) + near) / T, slope / T)

    def _near(self, position: FloatArray, slope: FloatArray) -> float:
        """Return the squares of missing distances, and add their derivative to `slope`, (T, n)."""
        margins = self.feasibility.margins(position)
        missing = np.maximum(-margins, 0.0) / _UNIT
        rows = np.flatnonzero(missing.any(axis=1))
        if rows.size:
            moved = np.repeat(position[rows][:, None], position.shape[1], axis=1)
            moved += _STEP * np.eye(position.shape[1])
            after = self.feasibility.margins(moved.reshape(-1, position.shape[1]))
            change = after.reshape(*moved.shape[:2], -1) - margins[rows][:, None]
            slope[rows] -= np.einsum("tm,tjm->tj", 2 * missing[rows] / _UNIT, change / _STEP)
        return float((missing**2).sum())
