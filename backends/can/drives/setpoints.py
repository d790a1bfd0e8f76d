"""A stream of position set-points, and what a drive does where one is missing."""

from __future__ import annotations

import math
from typing import Final

STREAM: Final = 3  # set-points in a row that make a stream
BRIDGED: Final = 1  # periods without set-point in which the joint goes on as it moves


class SetpointStream:
    """Positions that come once a period [rad].

    A set-point that is missing from a stream is bridged with the velocity that the joint has, as
    a hard stop and a jump after it would shake the arm. Where more are missing, the joint slows
    down. A single position that is written, and no stream, is just gone to.
    """

    def __init__(self) -> None:
        self.position = 0.0  # that is demanded now [rad]
        self.velocity = 0.0  # while set-points are missing [rad/s]
        self._length = 0  # set-points in a row
        self._missing = 0

    def start(self, position: float, velocity: float = 0.0) -> None:
        """Begin where the joint is [rad], as it moves [rad/s]."""
        self.position, self.velocity = position, velocity
        self._length = self._missing = 0

    def take(self, position: float) -> None:
        """Take the set-point of a period."""
        self.position = position
        self._length, self._missing = self._length + 1, 0

    def miss(self, target: float, velocity: float, period: float, deceleration: float) -> None:
        """Go on without a set-point for a period [s].

        Args:
            target: The last one [rad].
            velocity: Of the joint [rad/s].
            period: [s].
            deceleration: With which a stream that ended slows down [rad/s^2].
        """
        if self._length < STREAM:
            self.start(target)
            return
        self._missing += 1
        if self._missing <= BRIDGED:
            self.velocity = velocity
            self.position += period * velocity
        else:
            self.slow_down(period, deceleration)

    def slow_down(self, period: float, deceleration: float) -> bool:
        """Go on for a period [s] along a ramp [rad/s^2]; say whether it has come to rest."""
        slower = max(abs(self.velocity) - deceleration * period, 0.0)
        self.velocity = math.copysign(slower, self.velocity)
        self.position += period * self.velocity
        return slower == 0.0
