"""Decide who leads the set-point: the robot's application, an earlier client, or this one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from backends.fri.advice import advice, why_not_commanded
from backends.fri.answers import application_position, command_mode, left_position
from backends.fri.codec.messages import CommandMode, SessionState
from backends.fri.session import Order
from backends.fri.wire_limits import numbers

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.fri.codec.messages import CommandData, Joints, Monitoring
    from backends.fri.plausibility import Plausibility
    from backends.fri.session import Effect, RobotSession
    from backends.fri.wire_limits import WireLimits
    from limo_driver.robot.safety import SafetyContract
    from limo_driver.types import FloatArray

FLICKER: Final = 3  # packets in which no robot leaves COMMANDING_ACTIVE and enters it again
_ACTIVE: Final = SessionState.COMMANDING_ACTIVE  # quicker than by their classes
_NEXT: Final = Order.NEXT


class _Left(NamedTuple):
    """How an active session was left."""

    effect: Effect
    mode: CommandMode
    packet: int  # count of the one that said so
    measured: FloatArray  # by the one before, (n,) [rad]


class Lead:
    """Keeps the contract, and what leaves for the robot, in step with the session.

    Args:
        contract: Of the robot.
        wire: Limits between commands.
        session: Of the robot.
        plausible: Where the arm can have got to.
        hold: Holds for a reason.
    """

    def __init__(
        self,
        contract: SafetyContract,
        wire: WireLimits,
        session: RobotSession,
        plausible: Plausibility,
        hold: Callable[[str], None],
    ) -> None:
        self._contract, self._wire, self._session = contract, wire, session
        self._plausible, self._hold = plausible, hold
        self._joined = False  # COMMANDING_ACTIVE while it was so already
        self._measured: FloatArray = np.zeros(0)  # by the message before
        self._left: _Left | None = None  # lately, and maybe not really
        self._familiar: tuple[object, object] = (None, None)  # robot and connection, examined
        self.commanded = False  # by this client, since COMMANDING_ACTIVE was entered
        self.said: CommandData | None = None  # to the robot, last
        self.mode = CommandMode.NONE  # what may be commanded, since COMMANDING_ACTIVE was entered
        self.trouble = ""  # why nothing may be, although the session is active

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
            ipo, (robot, connection), self._measured = message.ipo, self._familiar, measured
            same = message.robot is robot and message.connection is connection
            if not (same and ipo is not None and ipo.command_mode is self.mode):
                self._examine(message)
            return  # most often
        if before is _ACTIVE:
            self._note_end(message, order, state)
        self._measured = measured
        goes_on = self._joined and order is not Order.RESTARTED
        self._joined = state is _ACTIVE and (before is None or goes_on)
        enters = before is None or before < SessionState.COMMANDING_WAIT
        if before is not state is _ACTIVE and self._flickered(measured):
            self._go_on()
        elif state is not _ACTIVE or enters or not self._wire.anchored:
            self._begin(self._leading(message), numbers(measured))
        elif not self.commanded and self._contract.at_rest:
            # Once commanded, the arm stays where that took it, not where the application would be;
            # nor does it follow a measurement: an arm told to be where it is would sink.
            told = self._leading(message) or numbers(self._contract.setpoint)
            self._contract.lead(np.array(self._wire.reachable(told)))
        if state is _ACTIVE:
            if not self.commanded:
                self.mode = command_mode(message)
            self._examine(message)
        elif state is SessionState.COMMANDING_WAIT:
            self._left = None  # it begins in order

    def _examine(self, message: Monitoring) -> None:
        """Hold where an active session says something that does not go with commands."""
        self._familiar = message.robot, message.connection  # most often the very same say the same
        self.trouble = why_not_commanded(message)
        if (mode := command_mode(message)) is not self.mode:
            self.trouble = f"the command mode changed from {self.mode.name} to {mode.name}"
        if self.trouble and not self._contract.at_rest:
            self._hold(f"in COMMANDING_ACTIVE, {self.trouble}")

    def _note_end(self, message: Monitoring, order: Order, state: SessionState | None) -> None:
        """Hold where an active session ends, or may have begun anew unseen."""
        if state is not _ACTIVE and state is not None:
            effect = self._contract.following, self._wire.sent, self.said
            self._left = _Left(effect, self.mode, self._session.packets, self._measured)
            reasons = "".join(f"; {said}" for said in advice(message)[:1])
            self._hold(f"the session left COMMANDING_ACTIVE for {state.name}{reasons}")
        elif order is Order.RESTARTED:
            now, last = message.header.sequence, self._session.before_restart
            self._hold(
                f"in COMMANDING_ACTIVE, the robot counts its packets anew: {now} came after {last}"
            )

    def _flickered(self, measured: FloatArray) -> bool:
        """Say whether a robot that left COMMANDING_ACTIVE cannot have done so.

        Nobody can be back at once, without COMMANDING_WAIT, where the arm has not moved: packets
        that said so were wrong, and the arm has been following commands all the time.
        """
        left = self._left
        if left is None:
            return False
        packets = self._session.packets - left.packet
        reach = self._plausible.reach(packets)
        return packets <= FLICKER and bool((np.abs(measured - left.measured) <= reach).all())

    def _go_on(self) -> None:
        """Go on from what had effect last."""
        if self._left is not None:
            effect, self.mode = self._left.effect, self._left.mode
            self.take_back(effect)
            self.commanded = True

    def take_back(self, effect: Effect) -> None:
        """Let the next answer follow from an earlier one: those since then had no effect."""
        setpoint, self._wire.sent, self.said = effect
        self._contract.take_back(setpoint)

    def _begin(self, told: Joints | None, measured: Joints) -> None:
        """Begin where the arm is told to be, or where it is; nowhere if neither can be."""
        if told is None and self._wire.usable(measured):
            told = measured
        self._wire.begin(told)
        self.commanded, self.said = False, None
        if told is not None:
            self._contract.lead(np.array(told))
        self._session.begin((self._contract.present, self._wire.sent, None))

    def _leading(self, message: Monitoring) -> Joints | None:
        """Return where the arm that nobody commands is told to be; None if nobody says.

        A session that was active before this driver heard of it was another client's: it starts
        where that left the arm, which need not be where the robot's application would have it.
        """
        said = left_position if self._joined else application_position
        return said(message, self._wire)
