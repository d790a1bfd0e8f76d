"""Poses that an arm can have got to since the last one, by its velocity limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from backends.fri.codec.messages import SessionState
from limo_driver.robot.measured import SLACK
from limo_driver.robot.setpoints import VELOCITY_TOLERANCE

if TYPE_CHECKING:
    from backends.fri.codec.messages import Joints, Monitoring
    from limo_driver.types import JointLimits

LONGEST: Final = 0.1  # [s] of silence that counts; an arm that is commanded holds by then
_WAIT: Final = SessionState.COMMANDING_WAIT
_MODULUS: Final = 1 << 32


class Plausibility:
    """Judges the poses of a session: where the arm is, and where its application has it.

    While nobody commands the arm, it may be anywhere.

    Args:
        limits: Limits of the joints.
        period: Send period [s].
    """

    def __init__(self, limits: JointLimits, period: float) -> None:
        self._fastest = tuple((VELOCITY_TOLERANCE * limits.velocity).tolist())
        self._period = period
        self._most = round(LONGEST / period)
        self._sequence = 0
        self._measured: Joints | None = None
        self._told: Joints | None = None

    @staticmethod
    def begins(message: Monitoring) -> bool:
        """Say whether a message can be the first of a new session: it commands nothing yet."""
        connection = message.connection
        return connection is None or connection.session_state < _WAIT

    def problem(self, message: Monitoring) -> str:
        """Say why the arm cannot be where a message has it; empty if it can."""
        if self.begins(message) or self._measured is None:
            return ""
        steps = min((message.header.sequence - self._sequence) % _MODULUS, self._most)
        time = (steps + 1) * self._period
        data, ipo = message.data, message.ipo
        measured = None if data is None else data.measured_position
        told = None if ipo is None else ipo.joint_position
        return self._jump(measured, self._measured, time, "is measured") or self._jump(
            told, self._told, time, "is told to be"
        )

    def take(self, message: Monitoring) -> None:
        """Note a message whose poses are believed."""
        self._sequence = message.header.sequence
        self._measured = None if message.data is None else message.data.measured_position
        self._told = None if message.ipo is None else message.ipo.joint_position

    def _jump(self, now: Joints | None, before: Joints | None, time: float, what: str) -> str:
        if now is None or before is None:
            return ""
        for j, (value, last, fastest) in enumerate(zip(now, before, self._fastest, strict=True)):
            if abs(value - last) > fastest * time + SLACK:
                return (
                    f"joint {j + 1} {what} {abs(value - last):.3g} rad from where it was "
                    f"{1e3 * time:.3g} ms before; a jump needs a new session"
                )
        return ""
