"""Last check before sending: each command stays within the limits of the one before.

The safety contract makes set-points; this only compares numbers that leave this machine, one after
the other, whoever made them: a set-point, a mirrored position of the robot's own application, or a
hold. The first of them is compared with where the arm stands; where nobody knows that, none leaves.
Torques and wrenches that are no longer wanted go to zero at their rate, not at once.

Seven numbers are quicker in plain Python than in arrays, and the wire takes plain numbers anyway;
but a set-point that changes nothing, which is what most are, is compared in one compiled call.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from limo_driver.robot.measured import RANGE_TOLERANCE
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, RobotSpec

Numbers: TypeAlias = tuple[float, ...]
# What was sent last: position [rad], the same where it was a set-point, and torque or wrench.
Sent: TypeAlias = "tuple[Numbers | None, FloatArray | None, Numbers | None]"

_ROUNDING: Final = 2e-6  # relative, twice the contract's own for a step of position
_LAST_DIGITS: Final = 1e-9  # relative, of a step of torque


class WireLimits:
    """Limits the change from one command to the next.

    Args:
        spec: Limits of the robot, and its period, which is from one command to the next.
    """

    def __init__(self, spec: RobotSpec) -> None:
        limits, period, wrench = spec.limits, spec.period, spec.wrench_limits
        self._step = numbers(limits.velocity * period * (1 + _ROUNDING))  # [rad]
        self._lower = numbers(limits.position_min - RANGE_TOLERANCE)
        self._upper = numbers(limits.position_max + RANGE_TOLERANCE)
        self._torque = numbers(limits.torque)
        self._torque_step = numbers(limits.torque_rate * period * (1 + _LAST_DIGITS))
        none = np.zeros(6)
        self._wrench = numbers(none if wrench is None else wrench.wrench)
        rate = none if wrench is None else wrench.rate
        self._wrench_step = numbers(rate * period * (1 + _LAST_DIGITS))
        self._bounds = np.array([self._step, self._lower, self._upper])
        self.changed = 0  # commands that had to be changed here
        self.begin(None)

    def begin(self, position: Numbers | None) -> None:
        """Begin anew: the robot is under its own command.

        Args:
            position: Where the arm stands, or is told to, within its range, (n,) [rad]; None where
                that is not known.
        """
        self.sent: Sent = position, None, None  # last; who sets it goes back to what had effect

    @property
    def anchored(self) -> bool:
        """Whether it is known where the arm stands."""
        return self.sent[0] is not None

    def usable(self, position: Numbers) -> bool:
        """Say whether a position that the robot names may be mirrored."""
        for value, lower, upper in zip(position, self._lower, self._upper, strict=True):
            if not lower <= value <= upper:  # a NaN compares false
                return False
        return True

    def reachable(self, wanted: Numbers) -> Numbers:
        """Return how close to a position the next command may come, (n,) [rad]."""
        last = self.sent[0]
        return wanted if last is None else _near(wanted, last, self._step)

    def position(self, wanted: Numbers) -> Numbers | None:
        """Return the position to send, (n,) [rad], within the arm's range; None for none."""
        last, _, effort = self.sent
        if last is None:
            return None
        sent = self.reachable(wanted)
        if not self.usable(sent):
            sent = last
        self.changed += sent is not wanted
        self.sent = sent, None, effort
        return sent

    def setpoint(self, wanted: FloatArray) -> Numbers | None:
        """Return the position to send of a set-point (n,) [rad]; most often just that."""
        _, last, effort = self.sent
        if last is None or not _keeps(wanted, last, self._bounds):
            sent = self.position(numbers(wanted))
            self.sent = sent, None if sent is None else np.array(sent), effort
            return sent
        told = numbers(wanted)
        self.sent = told, wanted, effort
        return told

    def torque(self, wanted: Numbers | None) -> Numbers:
        """Return the torque to send, (n,) [N m]; None asks for no torque."""
        return self._limited(wanted, self._torque, self._torque_step)

    def wrench(self, wanted: Numbers | None) -> Numbers:
        """Return the wrench to send, (6,) [N, N m]; None asks for no wrench."""
        return self._limited(wanted, self._wrench, self._wrench_step)

    def _limited(self, wanted: Numbers | None, most: Numbers, step: Numbers) -> Numbers:
        zero = (0.0,) * len(most)
        target = zero if wanted is None else _near(wanted, zero, most)
        position, last, effort = self.sent
        if effort is None or len(effort) != len(most):  # none so far, or one of the other kind
            effort = zero
        sent = _near(target, effort, step)
        self.changed += wanted is not None and sent is not wanted
        self.sent = position, last, sent
        return sent


@compiled(reads=("wanted", "last"))
def _keeps(wanted: FloatArray, last: FloatArray, bounds: FloatArray) -> bool:
    """Say whether a position keeps the range, and is a step from the last; a NaN does not."""
    for j in range(wanted.size):
        if not (
            abs(wanted[j] - last[j]) <= bounds[0, j] and bounds[1, j] <= wanted[j] <= bounds[2, j]
        ):
            return False
    return True


def warm_up_wire_limits(spec: RobotSpec) -> None:
    """Compile what compares set-points, before a robot waits for an answer."""
    limits, middle = WireLimits(spec), np.zeros(spec.n)
    limits.begin(numbers(middle))
    for _ in range(2):
        limits.setpoint(middle)


def numbers(values: FloatArray) -> Numbers:
    """Return an array as the wire takes it."""
    return tuple(values.tolist())


def _near(wanted: Numbers, last: Numbers, step: Numbers) -> Numbers:
    """Return `wanted` itself, or what is closest to it within a step of `last`."""
    for value, before, most in zip(wanted, last, step, strict=True):
        if not -most <= value - before <= most:
            break
    else:
        return wanted
    return tuple(
        min(max(value, before - most), before + most) if math.isfinite(value) else before
        for value, before, most in zip(wanted, last, step, strict=True)
    )
