"""Exploring phases: three random sinusoids for each joint around a scaffold."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.types import FloatArray, readonly

if TYPE_CHECKING:
    from limopa.request import Exploring


@dataclass(frozen=True)
class Exploration:
    """Sinusoidal path that starts at a scaffold; s is nominal time [s].

    q_j(s) = scaffold_j + e_j(s) - e_j(0),  e_j(s) = sum_k A_jk sin(2 pi f_jk s + phi_jk)

    Taking off e(0) lets the path start at the scaffold and leaves every derivative, and so every
    reversal, that of the sinusoids.

    Source: Algorithm 1 (LIMOPA) of the paper and the Fourier series in its text.
    """

    scaffold: FloatArray  # (n,) [rad]
    amplitude: FloatArray  # (n, k) [rad]
    frequency: FloatArray  # (n, k) [Hz] of nominal time
    phase: FloatArray  # (n, k) [rad]
    waypoints: int
    waypoint_period: float  # [s] of nominal time

    def __post_init__(self) -> None:
        for item in fields(self)[:4]:
            object.__setattr__(self, item.name, readonly(getattr(self, item.name)))

    @property
    def length(self) -> float:
        """Nominal time of the last waypoint [s]."""
        return (self.waypoints - 1) * self.waypoint_period

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` with respect to nominal time, (T, n) [rad/s^order]."""
        values = np.zeros((len(s), len(self.scaffold)))
        omega = 2 * np.pi * self.frequency
        for k in range(self.amplitude.shape[1]):
            angle = np.multiply.outer(s, omega[:, k]) + self.phase[:, k] + order * np.pi / 2
            values += self.amplitude[:, k] * omega[:, k] ** order * np.sin(angle)
        if order == 0:
            values += self.scaffold - np.sum(self.amplitude * np.sin(self.phase), axis=1)
        return values

    def peaks(self) -> FloatArray:
        """Return bounds of |q'|, |q''| and |q'''| of each joint, (3, n).

        Between waypoints a sinusoid exceeds its samples by at most 1 - cos(omega period / 2).
        """
        s = np.arange(self.waypoints, dtype=np.float64) * self.waypoint_period
        omega = 2 * np.pi * np.abs(self.frequency)
        missed = 1 - np.cos(np.minimum(omega * self.waypoint_period / 2, np.pi / 2))
        return np.stack(
            [
                np.abs(self.derivative(s, order)).max(axis=0)
                + np.sum(self.amplitude * omega**order * missed, axis=1)
                for order in (1, 2, 3)
            ]
        )


def draw_exploration(
    scaffold: FloatArray, ranges: Exploring, random: np.random.Generator
) -> Exploration:
    """Draw the sinusoids of one exploring phase around `scaffold`, (n,) [rad]."""
    shape = (len(scaffold), ranges.sinusoids)
    return Exploration(
        scaffold=scaffold,
        amplitude=random.uniform(*ranges.amplitude, shape),
        frequency=random.uniform(*ranges.frequency, shape),
        phase=random.uniform(*ranges.phase, shape),
        waypoints=int(random.integers(*ranges.waypoints, endpoint=True)),
        waypoint_period=ranges.waypoint_period,
    )
