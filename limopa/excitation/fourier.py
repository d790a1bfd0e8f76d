"""Fourier series that start and end at rest, each joint on harmonics of its own.

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

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from scipy.linalg import null_space

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

Harmonics: TypeAlias = tuple[tuple[int, ...], ...]  # of each joint, multiples of 1 / duration
ORDERS = 4  # position, velocity, acceleration, jerk


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
