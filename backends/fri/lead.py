"""Decide who leads the set-point: the robot's application, an earlier client, or this one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.advice import advice
from backends.fri.answers import application_position, left_position
from backends.fri.codec.messages import SessionState
from backends.fri.session import Order
from backends.fri.wire_limits import numbers

if TYPE_CHECKING:
    from backends.fri.codec.messages import CommandData, Joints, Monitoring
    from backends.fri.wire_limits import WireLimits
    from limo_driver.robot.safety import SafetyContract
    from limo_driver.types import FloatArray

_ACTIVE: Final = SessionState.COMMANDING_ACTIVE  # quicker than by their classes
_NEXT: Final = Order.NEXT


class Lead:
    """Keeps the contract, and what leaves for the robot, in step with the session.

    Args:
        contract: Of the robot.
        wire: Limits between commands.
    """

    def __init__(self, contract: SafetyContract, wire: WireLimits) -> None:
        self._contract, self._wire = contract, wire
        self._joined = False  # COMMANDING_ACTIVE while it was so already
        self.commanded = False  # by this client, since COMMANDING_ACTIVE was entered
        self.said: CommandData | None = None  # to the robot, last

    def follow(
        self,
        message: Monitoring,
        order: Order,
        states: tuple[SessionState | None, SessionState | None],
        measured: FloatArray,
    ) -> None:
        """Take a message into account.

        Args:
            message: What the robot says.
            order: How it stands to those before it.
            states: Of the session, before this message and since.
            measured: Where the arm is, (n,) [rad].
        """
        before, state = states
        if self.commanded and before is state is _ACTIVE and order is _NEXT and self._wire.anchored:
            return  # most often
        leaves = before is _ACTIVE and (state is not _ACTIVE or order is Order.RESTARTED)
        if leaves and state is not None:
            reasons = "".join(f"; {said}" for said in advice(message)[:1])
            self._contract.hold(f"the session left COMMANDING_ACTIVE for {state.name}{reasons}")
        goes_on = self._joined and order is not Order.RESTARTED
        self._joined = state is _ACTIVE and (before is None or goes_on)
        enters = before is None or before < SessionState.COMMANDING_WAIT
        if state is not _ACTIVE or leaves or enters or not self._wire.anchored:
            self._begin(self._leading(message), numbers(measured))
        elif not self.commanded and self._contract.at_rest:
            # Once commanded, the arm stays where that took it, not where the application would be;
            # nor does it follow a measurement: an arm told to be where it is would sink.
            told = self._leading(message) or numbers(self._contract.setpoint)
            self._contract.lead(np.array(self._wire.reachable(told)))

    def _begin(self, told: Joints | None, measured: Joints) -> None:
        """Begin where the arm is told to be, or where it is; nowhere if neither can be."""
        if told is None and self._wire.usable(measured):
            told = measured
        self._wire.begin(told)
        self.commanded, self.said = False, None
        if told is not None:
            self._contract.lead(np.array(told))

    def _leading(self, message: Monitoring) -> Joints | None:
        """Return where the arm that nobody commands is told to be; None if nobody says.

        A session that was active before this driver heard of it was another client's: it starts
        where that left the arm, which need not be where the robot's application would have it.
        """
        said = left_position if self._joined else application_position
        return said(message, self._wire)
