"""The last guard before the wire: what is commanded stays close to what was commanded before.

The safety contract makes set-points; this only compares numbers that leave this machine, one after
the other, whoever made them: a set-point, a mirrored position of the robot's own application, or a
hold. Torques and wrenches that are no longer wanted go to zero at their rate, not at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.safety import RANGE_TOLERANCE

if TYPE_CHECKING:
    from limo_driver.types import FloatArray, RobotSpec

_ROUNDING: Final = 2e-6  # relative, twice the contract's own for a step of position
_LAST_DIGITS: Final = 1e-9  # relative, of a step of torque


class WireLimits:
    """Limits the change from one command to the next.

    Args:
        spec: Limits of the robot, and its period, which is from one command to the next.
    """

    def __init__(self, spec: RobotSpec) -> None:
        limits, more = spec.limits, 1 + _LAST_DIGITS
        self._step = limits.velocity * spec.period * (1 + _ROUNDING)  # [rad]
        self._lower = limits.position_min - RANGE_TOLERANCE
        self._upper = limits.position_max + RANGE_TOLERANCE
        self._torque, self._torque_step = limits.torque, limits.torque_rate * spec.period * more
        wrench = spec.wrench_limits
        self._wrench = np.zeros(6) if wrench is None else wrench.wrench
        self._wrench_step = np.zeros(6) if wrench is None else wrench.rate * spec.period * more
        self.changed = 0  # commands that had to be changed here
        self.reset()

    def reset(self) -> None:
        """Begin anew: the robot is under its own command."""
        self._position: FloatArray | None = None  # [rad], sent last
        self._effort: FloatArray | None = None  # torque or wrench, sent last

    def usable(self, position: FloatArray) -> bool:
        """Say whether a position that the robot names may be mirrored."""
        return bool(((self._lower <= position) & (position <= self._upper)).all())  # NaN is not

    def reachable(self, wanted: FloatArray) -> FloatArray:
        """Return how close to a position the next command may come, (n,) [rad]."""
        last = self._position
        return wanted if last is None else _near(wanted, last, self._step)

    def position(self, wanted: FloatArray) -> FloatArray:
        """Return the position to send, (n,) [rad]."""
        sent = self.reachable(wanted)
        self._note(sent, wanted)
        self._position = sent
        return sent

    def torque(self, wanted: FloatArray | None) -> FloatArray:
        """Return the torque to send, (n,) [N m]; None asks for no torque."""
        return self._limited(wanted, self._torque, self._torque_step)

    def wrench(self, wanted: FloatArray | None) -> FloatArray:
        """Return the wrench to send, (6,) [N, N m]; None asks for no wrench."""
        return self._limited(wanted, self._wrench, self._wrench_step)

    def _limited(self, wanted: FloatArray | None, most: FloatArray, step: FloatArray) -> FloatArray:
        last = np.zeros(most.size) if self._effort is None else self._effort
        target = np.zeros(most.size) if wanted is None else wanted
        sent = _near(np.minimum(np.maximum(target, -most), most), last, step)
        if wanted is not None:
            self._note(sent, wanted)
        self._effort = sent
        return sent

    def _note(self, sent: FloatArray, wanted: FloatArray) -> None:
        self.changed += not np.array_equal(sent, wanted)


def _near(wanted: FloatArray, last: FloatArray, step: FloatArray) -> FloatArray:
    return np.minimum(np.maximum(wanted, last - step), last + step)
