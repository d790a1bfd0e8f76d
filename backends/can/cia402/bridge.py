"""Bridge: from where a drive holds to where a stream of set-points starts, without a step.

A stream starts from the measured pose, but a drive holds its last set-point: between the two are
its control error, whatever leans on the arm, and what a measurement may err. The difference is
added to the set-points and taken away slowly, so that the drive is never told to jump.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.robot.setpoints import PositionLimits

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, JointLimits

SHARE: Final = 0.05  # of the limits of velocity and acceleration, on top of the stream's own


class Bridge:
    """Offset that is added to the set-points of n joints.

    Args:
        limits: Of the joints.
        period: Cycle [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        n = limits.velocity.size
        slow = replace(
            limits,
            position_min=np.full(n, -np.inf),
            position_max=np.full(n, np.inf),
            velocity=SHARE * limits.velocity,
            acceleration=SHARE * limits.acceleration,
        )
        self._limits = PositionLimits(slow, period)
        self._zero = np.zeros(n)
        self.clear()
        self.advance()  # compiles before drives wait for it

    def clear(self) -> None:
        """Add nothing."""
        self.offset = self._velocity = self._zero  # (n,) [rad], [rad/s]

    def start(self, offset: FloatArray) -> None:
        """Begin with a difference (n,) [rad]."""
        self.offset, self._velocity = offset, self._zero

    def advance(self) -> None:
        """Take some of it away, once a cycle."""
        self.offset, self._velocity, _ = self._limits.follow(
            self._zero, self._zero, self.offset, self._velocity
        )
