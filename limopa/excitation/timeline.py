"""Timeline: commands of all joints, one after the other at an even rate."""

from __future__ import annotations

from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.trajectory import Segment

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray


class Timeline:
    """Set-points of n joints, each in force until the next.

    Args:
        start: First pose, (n,) [rad].
        rate: Of the set-points [Hz].
    """

    def __init__(self, start: FloatArray, rate: float) -> None:
        self.rate = rate
        self._parts: list[FloatArray] = [np.array(start)[None, :]]
        self._segments: list[Segment] = []
        self.rows = 1

    @property
    def pose(self) -> FloatArray:
        """Where it ends, (n,) [rad]."""
        return self._parts[-1][-1]

    @property
    def duration(self) -> float:
        """How long it is [s]."""
        return (self.rows - 1) / self.rate

    def follow(self, command: FloatArray, kind: str) -> None:
        """Add set-points, (T, n) [rad]."""
        if len(command):
            self._parts.append(command)
            self._segments.append(Segment(kind, self.rows, self.rows + len(command)))
            self.rows += len(command)

    def hold(self, seconds: float, kind: str = "hold") -> None:
        """Keep the pose."""
        self.follow(np.repeat(self.pose[None, :], self._many(seconds), axis=0), kind)

    def go(self, goal: FloatArray, speed: FloatArray, kind: str) -> None:
        """Lead smoothly to a pose, no joint faster than its speed (n,) [rad/s]."""
        away = goal - self.pose
        many = self._many(1.5 * float(np.max(np.abs(away) / speed)))  # 1.5: peak of a cubic
        s = np.arange(1, many + 1)[:, None] / max(many, 1)
        self.follow(self.pose + (3.0 - 2.0 * s) * s**2 * away, kind)

    def visit(
        self, j: int, away: Sequence[float], speed: float, kind: str, hold: float = 0.0
    ) -> None:
        """Lead a joint at an even speed to places from its pose, and reverse there.

        Args:
            j: Joint, 0-based.
            away: Places, from where it is [rad].
            speed: [rad/s].
            kind: What the motion is for.
            hold: At each place [s].
        """
        base, at = self.pose, 0.0
        parts: list[FloatArray] = []
        for place in away:
            many = self._many(abs(place - at) / speed)
            parts.append(at + (place - at) * np.arange(1, many + 1) / max(many, 1))
            parts.append(np.full(self._many(hold), place))
            at = place
        self._one(base, j, np.concatenate(parts), kind)

    def steps(self, j: int, away: Sequence[float], hold: float, kind: str) -> None:
        """Let a joint jump to places from its pose, and stay there [rad], [s]."""
        self._one(self.pose, j, np.repeat(np.array(away), self._many(hold)), kind)

    def finished(self) -> tuple[FloatArray, FloatArray, tuple[Segment, ...]]:
        """Return times (T,) [s], set-points (T, n) [rad] and what they are for."""
        command = np.concatenate(self._parts)
        return np.arange(len(command)) / self.rate, command, tuple(self._segments)

    def _one(self, base: FloatArray, j: int, away: FloatArray, kind: str) -> None:
        command = np.repeat(base[None, :], away.size, axis=0)
        command[:, j] += away
        self.follow(command, kind)

    def _many(self, seconds: float) -> int:
        return ceil(seconds * self.rate - 1e-9)
