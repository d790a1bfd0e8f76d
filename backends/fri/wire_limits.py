"""Last check before sending: each command stays within the limits of the one before.

The safety contract makes set-points; this only compares numbers that leave this machine, one after
the other, whoever made them: a set-point, a mirrored position of the robot's own application, or a
hold. The first of them is compared with where the arm stands; where nobody knows that, none leaves.
Torques and wrenches that are no longer wanted go to zero at their rate, not at once.

Seven numbers are quicker in plain Python than in arrays, and the wire takes plain numbers anyway;
but a set-point that changes nothing, which is what most are, is compared in one compiled call.

What is believed of a measurement, and the velocity that positions make.
"""

from __future__ import annotations

import math
from typing import Final, TypeAlias

import numpy as np

from backends.fri.codec.messages import Joints, Monitoring, SessionState
from backends.fri.connection import LARGEST_POSITION, LARGEST_TORQUE
from limo_driver.robot.measured import RANGE_TOLERANCE, SLACK
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, JointLimits, RobotSpec, readonly

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
        plain = numbers(wanted)
        self.sent = plain, wanted, effort
        return plain

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


LONGEST: Final = 0.1  # [s] of silence that counts; an arm that is commanded holds by then
_COMMANDED: Final = (SessionState.COMMANDING_ACTIVE, SessionState.COMMANDING_WAIT)
_ANYWHERE: Final = np.full(7, np.inf)
_MODULUS: Final = 1 << 32
TIME_CONSTANT: Final = 5e-3  # [s]
LONGEST_STEP: Final = 0.1  # [s]; beyond, the filter begins anew


class Plausibility:
    """Judges the poses of a session: where the arm is, and where its application has it.

    While nobody commands the arm, it may be anywhere.

    Args:
        limits: Limits of the joints.
        period: Send period [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self._fastest = VELOCITY_TOLERANCE * limits.velocity
        self._period = period
        self._most = round(LONGEST / period)
        self._reach = self.reach(1)  # of a message that follows the last, as most do
        self._sequence = 0
        self._measured: FloatArray | None = None
        self._ipo: Joints | None = None

    @staticmethod
    def begins(message: Monitoring) -> bool:
        """Say whether a message can be the first of a new session: it commands nothing yet."""
        connection = message.connection
        return connection is None or connection.session_state not in _COMMANDED

    def fine(self, message: Monitoring, position: FloatArray, torque: FloatArray) -> bool:
        """Say whether measurements are those of an arm, and its poses within reach.

        Args:
            message: That has them.
            position: Measured, (7,) [rad].
            torque: Measured, (7,) [N m].
        """
        before, connection = self._measured, message.connection
        if before is None or connection is None or connection.session_state not in _COMMANDED:
            return _fine(position, torque, position, _ANYWHERE)
        steps = (message.header.sequence - self._sequence) % _MODULUS
        reach = self._reach if steps == 1 else self.reach(min(steps, self._most))
        if not _fine(position, torque, before, reach):
            return False
        angles = None if message.ipo is None else message.ipo.joint_position
        return angles == self._ipo or not _jump(angles, self._ipo, reach, "")

    def problem(self, message: Monitoring) -> str:
        """Say why the arm cannot be where a message has it; empty if it can."""
        if self._measured is None or self.begins(message):
            return ""
        steps = (message.header.sequence - self._sequence) % _MODULUS
        reach, data, ipo = self.reach(min(steps, self._most)), message.data, message.ipo
        before = tuple(self._measured.tolist())
        measured = None if data is None else data.measured_position
        angles = None if ipo is None else ipo.joint_position
        return _jump(measured, before, reach, "is measured") or _jump(
            angles, self._ipo, reach, "is told to be"
        )

    def take(self, message: Monitoring, position: FloatArray) -> None:
        """Note a message whose poses are believed; measured, (7,) [rad]."""
        self._sequence, self._measured = message.header.sequence, position
        self._ipo = None if message.ipo is None else message.ipo.joint_position

    def reach(self, steps: int) -> FloatArray:
        """Return how far joints can get in so many send periods, and one more, (7,) [rad]."""
        return self._fastest * ((steps + 1) * self._period) + SLACK


@compiled(reads=("position", "torque", "before", "reach"))
def _fine(position: FloatArray, torque: FloatArray, before: FloatArray, reach: FloatArray) -> bool:
    """Say whether values can be measured, and are within reach; a NaN compares false."""
    for j in range(position.size):
        if not abs(position[j] - before[j]) <= reach[j]:
            return False
        if not (abs(position[j]) <= LARGEST_POSITION and abs(torque[j]) <= LARGEST_TORQUE):
            return False
    return True


def _jump(now: Joints | None, before: Joints | None, reach: FloatArray, what: str) -> str:
    """Say which joint is out of reach; empty if none is."""
    if now is None or before is None or now == before:
        return ""
    for j, (value, last, most) in enumerate(zip(now, before, reach, strict=True), start=1):
        if not -most <= value - last <= most:
            return (
                f"joint {j} {what} {abs(value - last):.3g} rad from where it was, further than "
                f"the {most:.3g} rad that it can have got; a jump needs a new session"
            )
    return ""


def warm_up_plausibility(middle: FloatArray) -> None:
    """Compile what judges measurements, before a robot waits for an answer."""
    _fine(middle, middle, middle, _ANYWHERE)


class VelocityFilter:
    """Differences through a causal low-pass of first order, for any spacing of the samples.

    v += dt / (dt + T) ((q - q_before) / dt - v), with the time constant T = 5 ms: it lags by about
    T, and halves the amplitude at 55 Hz.

    Args:
        n: Number of joints.
    """

    def __init__(self, n: int) -> None:
        self._time: float | None = None
        self._position = self.velocity = readonly(np.zeros(n))  # (n,) [rad, rad/s]

    def update(self, time: float, position: FloatArray) -> None:
        """Take a sample: robot time [s], position (n,) [rad], read-only."""
        if self._time is not None:
            step = time - self._time
            if step > LONGEST_STEP:
                self.velocity = readonly(np.zeros(position.size))
            elif step > 0.0:
                velocity = np.empty(position.size)
                _filter(self.velocity, position, self._position, step, velocity)
                velocity.setflags(write=False)
                self.velocity = velocity
        self._time, self._position = time, position


@compiled(reads=("velocity", "position", "before"))
def _filter(
    velocity: FloatArray, position: FloatArray, before: FloatArray, step: float, after: FloatArray
) -> None:
    """Write the velocity [rad/s] after a step [s]."""
    share = step / (step + TIME_CONSTANT)
    for j in range(after.size):
        after[j] = (1.0 - share) * velocity[j] + (share / step) * (position[j] - before[j])
