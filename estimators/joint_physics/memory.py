"""Variance of the torque while the initial state of the hysteresis is not known.

Memory begins with all stops in their middle. Before the joint turns, the true stops are anywhere
that they have been in training, z with M = E[z zᵀ], so that the torque g·z has the variance g M gᵀ,
with g the height of each stop: its weight in every family of columns, and what the simulation has
of the same width. Two copies of a stop that began apart come together as the joint turns. After it
turned by R one way, their mean squared distance, for any beginning as likely as another, has fallen
by the factor

    s² = ((1 - r)³ + 1) / 2 + 3 r (1 - r)² / 2    for r = R / w up to 1
    s² = (2 - r)³ / 2                             for r from 1 to 2, and 0 beyond,

whatever the joint did in between: a stop that saw the range 2 w has forgotten its beginning. So the
variance is u M uᵀ with u = s g.

Source: Visintin, "Differential Models of Hysteresis", 1994, ch. III (stops and their memory).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.joint_physics.column_scan import (
    FRICTION_HARMONICS,
    WIDTHS,
)
from limo_driver.physics import TorqueEffect
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from estimators.joint_physics.columns import JointColumns
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

_WAVES: Final = 2 * FRICTION_HARMONICS  # sines and cosines that friction goes with
_STOPS: Final = WIDTHS.size


@dataclass(frozen=True)
class UnknownMemory:
    """Heights of the stops of n joints, and how their states went together in training."""

    heights: FloatArray  # (n, 2 + waves, stops) [N m]: constant, with load [1], with each wave
    moments: FloatArray  # (n, stops, stops), E[z zᵀ]
    place: int  # first column of the family `place`, which holds the waves

    @classmethod
    def of(
        cls, columns: JointColumns, weights: FloatArray, moments: FloatArray, simulation: Simulation
    ) -> UnknownMemory:
        """Gather heights from weights (n, K) and the hysteresis of a simulation."""
        heights = weights[:, columns.stops]
        gains = np.diagonal(weights[:, columns.of_family("gain")])
        heights[:, 0] += (1.0 + gains[:, None]) * _simulated(simulation, columns.n)
        return cls(
            np.ascontiguousarray(heights),
            np.ascontiguousarray(moments),
            columns.of_family("place").start,
        )

    def variance(self, columns: FloatArray, about: FloatArray) -> FloatArray:
        """Return the variance that unknown memory adds to the torque, (T, n) [N² m²].

        Args:
            columns: (n, T, K).
            about: Range turned in so far [rad] and load [N m], (2, T, n).
        """
        found = np.empty(about.shape[1:])
        fill_variance(columns, about, self.heights, self.moments, self.place, found)
        return found


def moments_of(gram: FloatArray, count: FloatArray, columns: JointColumns) -> FloatArray:
    """Return E[z zᵀ] of the stops from Σ x xᵀ (n, K, K) of so many rows (n,)."""
    stops = slice(first := columns.of_family("friction").start, first + _STOPS)
    return gram[:, stops, stops] / count[:, None, None]


def any_moments(n: int) -> FloatArray:
    """Return what holds for any motion before: all stops as far as they go, the same way."""
    return np.ones((n, _STOPS, _STOPS))


def _simulated(simulation: Simulation, n: int) -> FloatArray:
    """Return the heights of the simulated stops, each shared by the two widths next to its own."""
    heights = np.zeros((n, _STOPS))
    for effect in simulation.effects:
        if isinstance(effect, TorqueEffect):
            for height, width in effect.stops():
                place = np.interp(np.log(width), np.log(WIDTHS), np.arange(_STOPS))
                below = min(int(place), _STOPS - 2)
                heights[effect.joint - 1, below] += (below + 1 - place) * height
                heights[effect.joint - 1, below + 1] += (place - below) * height
    return heights


@compiled(reads=("columns", "about", "heights", "moments"), nogil=True)
def fill_variance(
    columns: FloatArray,
    about: FloatArray,
    heights: FloatArray,
    moments: FloatArray,
    place: int,
    found: FloatArray,
) -> None:
    """Write u M uᵀ of each sample and joint to `found` (T, n)."""
    T, n = found.shape
    u = np.empty(_STOPS)
    for t in range(T):
        for j in range(n):
            turned, load = about[0, t, j], abs(about[1, t, j])
            first = 0  # stop that remembers, the narrowest
            while first < _STOPS and turned >= 2.0 * WIDTHS[first]:
                first += 1
            for i in range(first, _STOPS):
                height = heights[j, 0, i] + load * heights[j, 1, i]
                for k in range(_WAVES):
                    height += columns[j, t, place + k] * heights[j, 2 + k, i]
                u[i] = height * remembered(turned / WIDTHS[i])
            total = 0.0
            for i in range(first, _STOPS):
                for k in range(first, _STOPS):
                    total += u[i] * moments[j, i, k] * u[k]
            found[t, j] = max(total, 0.0)


@compiled(nogil=True)
def remembered(r: float) -> float:
    """Return s, how far apart two copies of a stop still are after r widths, on average."""
    if r >= 1.0:
        return np.sqrt(0.5 * (2.0 - r) ** 3)
    return np.sqrt(0.5 * ((1.0 - r) ** 3 + 1.0) + 1.5 * r * (1.0 - r) ** 2)
