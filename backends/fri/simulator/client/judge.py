"""Check the commands of a client against the limits of the simulated controller.

The limits are limo's model: KUKA's own 'illegal axis delta' stands in its manual only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from backends.fri.codec.messages import JOINTS, WRENCH, CommandMode
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from backends.fri.codec.messages import CommandData
    from limo_driver.types import FloatArray, JointLimits

MOST_INTERVALS: Final = 10  # that a step may have had time for, after answers were lost


def _limit(unit: str, description: str, default: float):  # noqa: ANN202  # a dataclass field
    return parameter(unit, description, lower=0, above=True, finite=False, default=default)


@dataclass(frozen=True)
class CommandLimits(Declared):
    """Limits of a command (limo's model)."""

    axis_delta: float = _limit("", "times the velocity limit, from one command to the next", 1.0)
    mirror: float = _limit("rad", "distance from the ipo position that confirms it", 0.01)
    torque: float = _limit("", "times the torque limit", 1.0)
    force: float = _limit("N", "each component of a wrench", 200.0)
    moment: float = _limit("N m", "each component of a wrench", 50.0)


class Wanted(NamedTuple):
    """Set-point that a command asks for."""

    position: FloatArray | None = None  # (7,) [rad]
    torque: FloatArray | None = None  # (7,) [N m]
    wrench: FloatArray | None = None  # (6,) [N, N m]


class CommandJudge:
    """Judges the commands of one session.

    Args:
        mode: What the application lets the client command.
        joints: Limits of the arm.
        limits: What a command may ask for.
        interval: From one command to the next [s].
    """

    def __init__(
        self, mode: CommandMode, joints: JointLimits, limits: CommandLimits, interval: float
    ) -> None:
        self.mode, self.limits, self.joints = mode, limits, joints
        self._step = limits.axis_delta * joints.velocity * interval
        self._torque = limits.torque * joints.torque
        self._wrench = np.array([limits.force] * 3 + [limits.moment] * 3)

    def read(self, data: CommandData | None) -> tuple[Wanted, str]:
        """Return the set-point of a command, and why it is ignored; empty if it is not."""
        if data is None:
            return Wanted(), "a command without data while the arm is to be commanded"
        parts = {
            "position": (data.joint_position, JOINTS),
            "torque": (data.joint_torque, JOINTS),
            "wrench": (data.wrench, WRENCH),
        }
        read: dict[str, FloatArray] = {}
        for name, (values, size) in parts.items():
            if values is None:
                continue
            if len(values) != size:
                return Wanted(), f"{name} has {len(values)} values, expected {size}"
            array = np.array(values)
            if not np.isfinite(array).all():
                return Wanted(), f"{name} is not finite"
            read[name] = array
        wanted = Wanted(**read)
        return wanted, self._missing(wanted)

    def confirms(self, wanted: Wanted, ipo: FloatArray) -> str:
        """Say why a command does not confirm the set-point in COMMANDING_WAIT; empty if it does."""
        if wanted.position is None:
            return ""  # of torque or wrench alone; `read` saw that they are there
        off = np.abs(wanted.position - ipo)
        if (off <= self.limits.mirror).all():
            return ""
        j = int(np.argmax(off))
        return (
            f"in COMMANDING_WAIT joint {j + 1} has to mirror the ipo position; it is off by more "
            f"than {self.limits.mirror:g} rad"
        )

    def share_of_step(self, wanted: Wanted, before: FloatArray, intervals: int) -> float:
        """Return how far a command goes, as a share of what a joint may in that time."""
        if wanted.position is None:
            return 0.0
        return float((np.abs(wanted.position - before) / self._most_step(intervals)).max())

    def stops(self, wanted: Wanted, before: FloatArray, intervals: int) -> str:
        """Say why the arm has to stop for a command; empty if it need not.

        Args:
            wanted: The command.
            before: Position commanded before, (7,) [rad].
            intervals: Receive intervals since then.
        """
        if wanted.position is not None:
            step = self._most_step(intervals)
            delta = np.abs(wanted.position - before)
            if (delta > step).any():
                j = int(np.argmax(delta / step))
                return (
                    f"illegal axis delta: joint {j + 1} is told to jump by {delta[j]:.4g} rad, "
                    f"at most {step[j]:.4g} rad"
                )
            low, high = self.joints.position_min, self.joints.position_max
            for j in np.flatnonzero((wanted.position < low) | (wanted.position > high)):
                return (
                    f"joint {j + 1} is told to go to {wanted.position[j]:.4g} rad, outside "
                    f"{low[j]:.4g} to {high[j]:.4g} rad"
                )
        for values, most, what, unit in (
            (wanted.torque, self._torque, "joint", "N m"),
            (wanted.wrench, self._wrench, "wrench component", "N or N m"),
        ):
            if values is not None and (np.abs(values) > most).any():
                j = int(np.argmax(np.abs(values) / most))
                return f"{what} {j + 1} is told {values[j]:.4g} {unit}, at most {most[j]:.4g}"
        return ""

    def _most_step(self, intervals: int) -> FloatArray:
        return self._step * min(max(intervals, 1), MOST_INTERVALS)

    def _missing(self, wanted: Wanted) -> str:
        """Say which part a command lacks for the mode, or has without any use."""
        needed = {
            CommandMode.POSITION: wanted.position,
            CommandMode.TORQUE: wanted.torque,
            CommandMode.WRENCH: wanted.wrench,
        }
        mode = self.mode.name.lower()
        if self.mode in needed and needed[self.mode] is None:
            return f"a command without {mode} in {mode} mode"
        for other, values in needed.items():
            extra = other not in {self.mode, CommandMode.POSITION} and values is not None
            if extra and values is not None and values.any():
                return f"a command with {other.name.lower()} in {mode} mode"
        return ""
