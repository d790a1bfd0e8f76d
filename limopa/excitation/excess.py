"""By how much a motion exceeds its limits, as one smooth number that an optimiser can descend."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from limopa.retiming import OVERSHOOT

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits
    from limopa.feasibility import Feasibility

_SHARE = 0.98  # of the limits of velocity and acceleration
_UNIT = 0.1  # [m] too near that counts as much as twice the velocity limit
_STEP = 1e-6  # [rad] of finite differences


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
