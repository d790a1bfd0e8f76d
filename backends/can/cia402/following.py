"""Whether joints follow their set-points, as they measure it.

A joint that moves is behind its set-point by the time that its drive takes, so that it is compared
with all set-points of the last three cycles, or of 20 ms: it has to be within reach of one of them,
or between them. One that stands still while it is told to move is out of that 20 ms later.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from backends.can.cia402.drive import Drive
    from limo_driver.types import FloatArray

LAG: Final = 0.02  # [s] that a joint may take to follow
LAG_PERIODS: Final = 3  # or so many periods, if those are longer


def longest_lag(period: float) -> float:
    """Return how long a joint may take to follow where cycles have a period, both in [s]."""
    return max(LAG, LAG_PERIODS * period)


class FollowingCheck:
    """Compares what joints measure with what they were told.

    Args:
        n: Number of joints.
        period: Of the cycles [s].
        window: How far a joint may be off [rad].
    """

    def __init__(self, n: int, period: float, window: float) -> None:
        self._told = np.zeros((math.ceil(longest_lag(period) / period - 1e-9) + 1, n))
        self._at, self._window = 0, window
        self._off, self._position = 0, np.zeros(n)
        self.judge(self._position)  # compiled before a drive waits for it

    def begin(self, joints: int | slice, position: FloatArray) -> None:
        """Begin anew with some joints, from 0, that stand at a position (n,) [rad]."""
        self._told[:, joints] = position[joints]
        self._off = 0

    def note(self, target: FloatArray) -> None:
        """Note the set-point of a cycle, (n,) [rad]."""
        self._at = (self._at + 1) % len(self._told)
        self._told[self._at] = target

    def judge(self, position: FloatArray) -> None:
        """Judge a position that was measured, (n,) [rad]."""
        self._off, self._position = _first_off(position, self._told, self._window), position

    def complaint(self, drives: Sequence[Drive]) -> str:
        """Say which joint does not follow; empty if all do."""
        if not self._off:
            return ""
        drive, j = drives[self._off - 1], self._off - 1
        away = float(np.abs(self._position[j] - self._told[:, j]).min())
        return (
            f"joint {drive.joint} (node {drive.node}) does not follow: it is {away:.3g} rad off "
            f"its latest set-points, at most {self._window:g} rad (following_error)"
        )


@compiled(reads=("position",))
def _first_off(position: FloatArray, told: FloatArray, window: float) -> int:
    """Return the first joint, from 1, that is off all that it was told; 0 if none."""
    for j in range(position.size):
        lower, upper = told[0, j], told[0, j]
        for k in range(1, told.shape[0]):
            lower, upper = min(lower, told[k, j]), max(upper, told[k, j])
        if not lower - window <= position[j] <= upper + window:
            return j + 1
    return 0
