"""Answer the robot, and count on nothing that did not reach it.

An answer has effect once the robot has received it, which its next packets say by the sequence
that they reflect. What the network did not take is withheld at once. What the robot does not
confirm in time is held. Nothing more is sent then until the last command had its time, too, and is
taken back; from there on one command at a time is sent and waited for, until the robot confirms
something again. So whatever arrives first is one step from what had effect last, and what arrives
next is one from that, however late the robot says so.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from backends.fri.answers import answer_to
from backends.fri.codec.messages import SessionState
from backends.fri.codec.template import CommandTemplate
from limo_driver.runtime.latency import LatencyHistogram
from limo_driver.types import PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable

    from backends.fri.codec.messages import Monitoring
    from backends.fri.connection import Connection
    from backends.fri.lead import Lead
    from backends.fri.outputs import Outputs
    from backends.fri.session import RobotSession
    from backends.fri.wire_limits import WireLimits
    from limo_driver.robot.output import Setpoint
    from limo_driver.robot.safety import SafetyContract
    from limo_driver.types import JointCommand


class Replies:
    """Answers packets, one after the other.

    Args:
        link: The way to the robot.
        session: Counts what is answered and confirmed.
        contract: Whose set-points are answered with.
        wire: Limits between commands.
        lead: Who leads the set-point.
        outputs: That the user sets.
    """

    def __init__(
        self,
        link: Connection,
        session: RobotSession,
        contract: SafetyContract,
        wire: WireLimits,
        lead: Lead,
        outputs: Outputs,
    ) -> None:
        self._link, self._session, self._contract = link, session, contract
        self._wire, self._lead, self._outputs = wire, lead, outputs
        self._writer = CommandTemplate(link.generation)
        self.latency = LatencyHistogram()  # from a packet's arrival to its answer
        self.carried: Setpoint | None = None  # by the last answer that left

    def reply(self, message: Monitoring, arrived: float, command: JointCommand | None) -> bool:
        """Answer a message, with a command or by what the driver answers itself.

        Args:
            message: To be answered.
            arrived: When it came [s], of this machine's monotonic clock.
            command: Within the limits; None to hold.

        Returns:
            Whether anything left for the robot.
        """
        if self._awaits:
            return False
        before, session, lead, contract = (
            self._wire.sent, self._session, self._lead, self._contract,
        )  # fmt: skip
        answer = answer_to(
            message,
            session.next_sequence(),
            self._link.generation,
            self._wire,
            command.position if isinstance(command, PositionCommand) else contract.setpoint,
            command,
            self._outputs.waiting,
            lead.mode,
        )
        if answer is None:
            return False
        if not self._link.endpoint.send(self._writer.encode(answer)):
            session.note_refusal()
            self._wire.sent = before
            return False
        lead.said = answer.data
        self.carried = contract.following
        now = time.monotonic()
        session.note_answer((self.carried, self._wire.sent, answer.data), now)
        self._outputs.note_sent(answer.header.sequence)
        self.latency.add(now - arrived)
        return True

    @property
    def _awaits(self) -> bool:
        """Whether nothing may be sent before it is known what became of the commands before."""
        session = self._session
        if session.state is not SessionState.COMMANDING_ACTIVE or self._contract.at_rest:
            return False
        return session.overdue and not session.all_overdue

    def settle(self, hold: Callable[[str], None]) -> None:
        """Act on answers that have no effect, before the next one: called once a packet."""
        session = self._session
        overdue = session.overdue
        if not (overdue or session.refused) or self._contract.at_rest:
            return
        waited = session.patience * session.period
        if session.refused:
            hold(f"no command could be sent for {waited:.3g} s: {self._link.endpoint.refusal}")
        if overdue:
            hold(f"the robot has received none of the last {session.unconfirmed} commands")
            if session.all_overdue and (effect := session.confirmed) is not None:
                self._lead.take_back(effect)
