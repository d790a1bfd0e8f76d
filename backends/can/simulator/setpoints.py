"""Stream of position set-points, in which a drive bridges those that are missing."""

from __future__ import annotations

import math
from typing import Final

STREAM: Final = 3  # set-points in a row that make a stream
BRIDGED: Final = 1  # periods without set-point in which the joint goes on as it moves
RETURN_RATE: Final = 20.0  # [rad/s], of the critically damped way back to the stream
NEGLIGIBLE: Final = 1e-9  # [rad]


class SetpointStream:
    """Positions that come once a period [rad].

    A set-point that is missing from a stream is bridged with the velocity that the joint has; where
    more are missing, the joint slows down. Once the stream goes on, the joint returns to it without
    a jolt. A single position that is written, and no stream, is just gone to.
    """

    def __init__(self) -> None:
        self.position = 0.0  # that is demanded now [rad]
        self.velocity = 0.0  # while set-points are missing [rad/s]
        self.start(0.0)

    def start(self, position: float, velocity: float = 0.0) -> None:
        """Begin where the joint is [rad], as it moves [rad/s]."""
        self.position, self.velocity = position, velocity
        self._target, self._rate = position, 0.0  # of the stream [rad], [rad/s]
        self._off, self._off_rate = 0.0, 0.0  # from the stream [rad], [rad/s]
        self._length = self._missing = 0

    def take(self, target: float, period: float) -> None:
        """Take the set-point of a period [s]."""
        if self._missing:
            self._off = self.position - (target - period * self._rate)
            self._off_rate = self.velocity - self._rate
        else:
            self._rate = (target - self._target) / period
        self._target, self._missing, self._length = target, 0, self._length + 1
        self._return(period)
        self.position = target + self._off

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

    def _return(self, period: float) -> None:
        """Come closer to the stream: x'' + 2 w x' + w^2 x = 0, solved over a period [s]."""
        if not self._off:
            return
        w, fading = RETURN_RATE, math.exp(-RETURN_RATE * period)
        slope = self._off_rate + w * self._off
        self._off_rate = (self._off_rate - w * slope * period) * fading
        self._off = (self._off + slope * period) * fading
        if abs(self._off) < NEGLIGIBLE and abs(self._off_rate) < NEGLIGIBLE:
            self._off = self._off_rate = 0.0
