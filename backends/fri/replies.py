"""Answer the robot, and count on nothing that did not reach it.

An answer has effect once the robot has received it, which its next packets say by the sequence
that they reflect. What the network did not take is withheld at once. What the robot does not
confirm in time is held. Nothing more is sent then until the last command had its time, too, and is
taken back; from there on one command at a time is sent and waited for, until the robot confirms
something again. So whatever arrives first is one step from what had effect last, and what arrives
next is one from that, however late the robot says so.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.answers import MONITORING, Lead, answer_to
from backends.fri.codec.messages import MAX_IO, IoDirection, IoType, IoValue, Monitoring
from backends.fri.codec.template import CommandTemplate
from limo_driver.errors import ConfigError
from limo_driver.robot.realtime import LatencyHistogram
from limo_driver.types import JointCommand, PositionCommand

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from backends.fri.connection import Connection
    from backends.fri.session import RobotSession
    from backends.fri.wire_limits import WireLimits
    from limo_driver.robot.output import Setpoint
    from limo_driver.robot.safety import SafetyContract

_DIGITAL: Final = 1 << 64
_HALF: Final = 1 << 31


class Replies:
    """Answers packets, one after the other.

    Args:
        link: The way to the robot.
        session: Counts what is answered and confirmed.
        contract: Whose set-points are answered with.
        wire: Limits between commands.
        lead: Who leads the set-point.
        outputs: That the user sets.
        listen_only: Answer nothing that could be taken for a command, or lead to commands.
    """

    def __init__(
        self,
        link: Connection,
        session: RobotSession,
        contract: SafetyContract,
        wire: WireLimits,
        lead: Lead,
        outputs: Outputs,
        *,
        listen_only: bool = False,
    ) -> None:
        self._link, self._session, self._contract = link, session, contract
        self._wire, self._lead, self._outputs = wire, lead, outputs
        self._writer = CommandTemplate(link.generation)
        self._listen_only = listen_only
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
        if self._awaits or (self._listen_only and not self._is_ignored):
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
            leads=lead.leads,
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
    def _is_ignored(self) -> bool:
        """Whether the robot ignores what it is answered, and no answer leads on to commands."""
        return self._session.state in MONITORING and not self._lead.leads

    @property
    def _awaits(self) -> bool:
        """Whether nothing may be sent before it is known what became of the commands before."""
        session = self._session
        if not self._lead.leads or self._contract.at_rest:
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


class Outputs:
    """Values on their way to the robot; each stays until an answer with it was received."""

    def __init__(self) -> None:
        self._values: dict[str, IoValue] = {}
        self._since: dict[str, int] = {}  # sequence of the first answer with the value

    @property
    def waiting(self) -> tuple[IoValue, ...]:
        """What the next answer has to say; what does not fit waits for its turn."""
        return tuple(self._values.values())[:MAX_IO] if self._values else ()

    def set(self, name: str, value: float | bool, known: Sequence[IoValue]) -> None:
        """Take a value for an output that the robot's application named.

        Raises:
            ConfigError: No such output, or a value of another type.
        """
        found = next((io for io in known if io.name == name), None)
        if found is None:
            names = ", ".join(io.name for io in known) or "none"
            raise ConfigError(f"the robot's application names no IO {name!r}; it names: {names}")
        if found.direction is not IoDirection.OUTPUT:
            raise ConfigError(f"{name} is an input; only outputs can be set")
        self._values[name] = _valued(found, value)
        self._since.pop(name, None)

    def note_sent(self, sequence: int) -> None:
        """Note the sequence of an answer that carried what was waiting."""
        for io in self.waiting if self._values else ():
            # A robot that has received nothing reflects 0, too: the first answer confirms nothing.
            self._since.setdefault(io.name, max(sequence, 1))

    def note_received(self, sequence: int) -> None:
        """Note the last answer that the robot received."""
        if not self._since:
            return
        for name, since in list(self._since.items()):
            if (sequence - since) % (2 * _HALF) < _HALF:
                del self._since[name], self._values[name]


def _valued(io: IoValue, value: float | bool) -> IoValue:
    """Return the output with a value of its type."""
    if io.type is IoType.ANALOG:
        if isinstance(value, bool) or not _finite(value):
            raise ConfigError(f"{io.name} is analog, but {value!r} was given")
        return IoValue(io.name, io.type, io.direction, analog=float(value))
    if io.type is IoType.BOOLEAN:
        if value not in (0, 1):
            raise ConfigError(f"{io.name} is a boolean, but {value!r} was given")
        return IoValue(io.name, io.type, io.direction, digital=int(value))
    if isinstance(value, bool) or not _finite(value) or value % 1 or not 0 <= value < _DIGITAL:
        raise ConfigError(f"{io.name} is an integer of 64 bits, but {value!r} was given")
    return IoValue(io.name, io.type, io.direction, digital=int(value))


def _finite(value: object) -> bool:
    try:
        return isinstance(value, (int, float, np.number)) and math.isfinite(value)
    except OverflowError:  # an integer beyond all floats
        return False
