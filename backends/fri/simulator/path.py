"""Interpolate the set-point of the arm, each millisecond, between the commands of a client.

A command comes once every receive interval. Between p₀, p₁ and the newest p₂ the set-point moves on
the mean over one interval of the polyline through them: at a fraction u of the interval

    q(u) = p₁ + ½ (p₂ − p₁) u² − ½ (p₁ − p₀) (1 − u)²

so that its velocity has no steps; it is half an interval behind. An interval of one millisecond is
followed as it is. One command that did not come is bridged by going on at the same velocity; when
more are missing, the arm comes to rest on the last one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

STEP: Final = 1e-3  # [s], of the arm's own control


class SetpointPath:
    """The set-point of the arm.

    Args:
        position: Where it stands, (n,) [rad].
        acceleration: With which it brakes, (n,) [rad/s²].
        steps: Milliseconds in one receive interval.
    """

    def __init__(self, position: FloatArray, acceleration: FloatArray, steps: int) -> None:
        self.steps = steps
        self._acceleration = acceleration
        self.rest_at(position, np.zeros_like(position))

    def rest_at(self, position: FloatArray, velocity: FloatArray) -> None:
        """Go on from a pose and its velocity, (n,) each [rad, rad/s], braking."""
        self.position, self.velocity = position.copy(), velocity.copy()
        self._base: FloatArray | None = None  # where the arm rests, less the program's motion
        self._standing = False  # there, with no motion to come
        self._begin_interval(self.position)

    def follow(self, command: FloatArray | None, count: int) -> FloatArray:
        """Return the next `count` set-points towards a client's command, (count, n) [rad].

        Args:
            command: The newest position commanded, (n,) [rad], if one came.
            count: Milliseconds.
        """
        self._base, self._standing = None, False
        if command is not None:
            self._command, self._missing = command, 0
        targets = np.empty((count, self.position.size))
        for row in range(count):
            if self._done == self.steps:
                self._points = (self._points[1], self._points[2], self._next_point())
                self._done = 0
            self._done += 1
            targets[row] = self._between(self._done / self.steps)
        return self._told(targets)

    def rest(self, program: FloatArray, count: int) -> FloatArray:
        """Return the next `count` set-points without a client: braking, then the program's motion.

        Args:
            program: How far the robot's program has moved the joints away from where they rest,
                at the end of these steps, (n,) [rad].
            count: Milliseconds.
        """
        if self._standing and not program.any():
            return np.repeat(self.position[None], count, axis=0)
        targets = np.empty((count, self.position.size))
        if self._base is None and self.velocity.any():
            position, velocity = self.position, self.velocity
            for row in range(count):
                position, velocity = slow_down(position, velocity, self._acceleration, STEP)
                targets[row] = position
            self.position, self.velocity = position, velocity
            self._begin_interval(position)
            return targets
        base = self.position - program if self._base is None else self._base
        self._base, goal = base, base + program
        steps = np.arange(1, count + 1)[:, None] / count
        targets[:] = self.position + (goal - self.position) * steps
        self._told(targets)
        self._standing = not program.any()
        self.velocity *= not self._standing  # of the last step to where it rests, otherwise
        self._begin_interval(self.position)
        return targets

    def _next_point(self) -> FloatArray:
        """Return where the set-point goes in the interval that begins, (n,) [rad]."""
        self._missing += 1  # until a command comes
        if self._missing == 2:  # noqa: PLR2004  # of the interval before and of this one
            return 2.0 * self._points[2] - self._points[1]
        return self._command

    def _between(self, u: float) -> FloatArray:
        p0, p1, p2 = self._points
        if self.steps == 1:
            return p2
        return p1 + 0.5 * (p2 - p1) * u * u - 0.5 * (p1 - p0) * (1.0 - u) ** 2

    def _begin_interval(self, position: FloatArray) -> None:
        self._points = (position, position, position)
        self._command, self._missing = position, 0
        self._done = self.steps

    def _told(self, targets: FloatArray) -> FloatArray:
        before = targets[-2] if len(targets) > 1 else self.position
        self.velocity = (targets[-1] - before) / STEP
        self.position = targets[-1].copy()
        return targets


def slow_down(
    position: FloatArray, velocity: FloatArray, acceleration: FloatArray, period: float
) -> tuple[FloatArray, FloatArray]:
    """Return the next set-point of an arm that brakes to rest, and its velocity."""
    slower = np.sign(velocity) * np.maximum(np.abs(velocity) - acceleration * period, 0.0)
    return position + slower * period, slower
