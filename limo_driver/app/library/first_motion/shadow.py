"""A robot whose commands are computed, within its limits, and go nowhere."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from limo_driver.errors import BackendError, CycleTimeoutError
from limo_driver.robot.robot import READY_TIMEOUT, Robot
from limo_driver.types import FloatArray, JointCommand, JointState


def first_state(robot: Robot, timeout: float) -> JointState:
    """Return the first measurement of an arm that was opened just now.

    Args:
        robot: That listens.
        timeout: Longest wait [s].

    Raises:
        BackendError: None came in time.
    """
    ends = robot.now() + timeout
    while robot.now() < ends:
        with suppress(CycleTimeoutError):
            if not (state := robot.receive()).stale:
                return state
    raise BackendError(f"no measurement came within {timeout:g} s")


class ShadowRobot(Robot):
    """The states of a robot that was opened to listen only, and the safety contract of its own.

    What `send` returns is what the drives would have been sent; nothing leaves for them.

    Args:
        robot: Open to listen only; closed with the shadow.
    """

    def __init__(self, robot: Robot) -> None:
        self._listener = robot
        super().__init__(robot.spec)

    @property
    def lost(self) -> int:
        """Measurements that did not come over the link."""
        return self._listener.lost

    def now(self) -> float:
        """Return the time of the clock by which cycles are waited for [s]."""
        return self._listener.now()

    def wait_until_ready(self, timeout: float = READY_TIMEOUT) -> None:
        """Wait for a first measurement.

        Args:
            timeout: Longest wait [s].

        Raises:
            BackendError: None came in time.
        """
        first_state(self, timeout)

    def link_figures(self) -> dict[str, Any]:
        """Return what was counted on the link."""
        return self._listener.link_figures()

    def _receive(self, timeout: float | None) -> JointState | None:
        state = self._listener.receive(timeout)
        return None if state.stale else state

    def _send(self, command: JointCommand) -> JointCommand | None:
        """Send nothing."""

    def _gravity(self) -> Callable[[], FloatArray] | None:
        return self._listener._gravity()  # the contract is the listener's, too

    def _gains(self) -> tuple[FloatArray, FloatArray] | None:
        return self._listener._gains()

    def _close(self) -> None:
        self._listener.close()
