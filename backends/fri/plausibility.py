"""What is believed of a measurement, and the velocity that positions make."""

from __future__ import annotations

from typing import Final

import numpy as np

from backends.fri.codec.messages import Joints, Monitoring, SessionState
from backends.fri.connection import LARGEST_POSITION, LARGEST_TORQUE
from limo_driver.robot.measured import SLACK
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, JointLimits, readonly

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
        self._told: Joints | None = None

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
        told = None if message.ipo is None else message.ipo.joint_position
        return told == self._told or not _jump(told, self._told, reach, "")

    def problem(self, message: Monitoring) -> str:
        """Say why the arm cannot be where a message has it; empty if it can."""
        if self._measured is None or self.begins(message):
            return ""
        steps = (message.header.sequence - self._sequence) % _MODULUS
        reach, data, ipo = self.reach(min(steps, self._most)), message.data, message.ipo
        before = tuple(self._measured.tolist())
        measured = None if data is None else data.measured_position
        told = None if ipo is None else ipo.joint_position
        return _jump(measured, before, reach, "is measured") or _jump(
            told, self._told, reach, "is told to be"
        )

    def take(self, message: Monitoring, position: FloatArray) -> None:
        """Note a message whose poses are believed; measured, (7,) [rad]."""
        self._sequence, self._measured = message.header.sequence, position
        self._told = None if message.ipo is None else message.ipo.joint_position

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
