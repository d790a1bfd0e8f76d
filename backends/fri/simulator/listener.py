"""The controller's ear: what comes is counted, read, judged, and passed on if it may."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from backends.fri.codec.template import CommandTemplate
from backends.fri.simulator.judge import CommandJudge
from backends.fri.simulator.ledger import Arrival, Ledger
from backends.fri.simulator.link import Channel
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from backends.fri.codec.messages import Command
    from backends.fri.simulator.judge import Wanted
    from backends.fri.simulator.link import Disturbance
    from backends.fri.simulator.motion import CommandedArm
    from backends.fri.simulator.port import Address, UdpPort
    from backends.fri.simulator.report import ClientObservations
    from backends.fri.simulator.session import ControllerSession
    from backends.fri.simulator.settings import ControllerSettings

_COUNTERS: Final = 1 << 32
_WRONG: Final = {
    Arrival.REPEATED: "an answer reflects a packet that was answered before",
    Arrival.UNKNOWN: "an answer reflects a packet that was never sent, or long ago",
}


class Listener:
    """Listens to one client.

    Args:
        settings: Of the controller.
        client: Whose datagrams count.
        seed: Of the network's fates.
        findings: What is noted about the client.
        motion: Told the commands that count.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        client: Address,
        seed: int,
        findings: ClientObservations,
        motion: CommandedArm,
    ) -> None:
        self._settings, self._client = settings, client
        self._findings, self._motion = findings, motion
        late = settings.late_after
        self.ledger = Ledger(settings.multiplier, None if late is None else round(1e9 * late))
        self.network = Channel("to_robot", seed)
        self.reflected = 0  # the client's last counter
        self.confirmed = 0  # answers in a row that confirm the set-point
        self.stop = ""  # why a command stopped the arm; empty if none did lately
        self._stop_until = 0.0  # [s]
        self._asked_from = 0  # counter of the first packet that asked for commands
        self.begin()
        self._commands = CommandTemplate(settings.version)
        interval = 1e-3 * settings.interval_ms
        self._judge = CommandJudge(settings.mode, motion.limits, settings.limits, interval)

    def ask(self) -> None:
        """Expect commands in answer to all packets from the next on."""
        self.confirmed, self._asked_from = 0, self.ledger.next_sequence

    def listen(
        self, port: UdpPort, now: float, network: Disturbance, session: ControllerSession
    ) -> None:
        """Take the answers that have come.

        Args:
            port: Where they come.
            now: Since the start [s].
            network: What it does to them.
            session: Which commands it lets count.
        """
        if self.stop and now >= self._stop_until:
            self.stop = ""
        for datagram in port.received():
            if datagram.sender != self._client:
                self._findings.strangers += 1
                self._findings.complain(
                    f"datagrams come from {datagram.sender} and not from the client "
                    f"{self._client}: they are ignored",
                    now,
                )
                continue
            self.network.put(datagram.data, datagram.at_ns, network)
        for data, at_ns in self.network.take(time.monotonic_ns()):
            self._receive(data, at_ns, now, session)

    def close_interval(self) -> bool | None:
        """End the receive interval if it is over; return whether it was answered in time."""
        answered = self.ledger.close_interval()
        if self._followed and answered is not None:
            self.begin()
        else:
            self._intervals += answered is not None
        if answered is False:
            self.confirmed = 0
        return answered

    def begin(self) -> None:
        """Measure the steps of commands from where the arm is told to be by now."""
        self._before = self._motion.commanded  # (7,) [rad]
        self._intervals = 1  # that a command has had since
        self._followed = False  # one, in this interval

    def _receive(self, data: bytes, at_ns: int, now: float, session: ControllerSession) -> None:
        try:
            command = self._commands.decode(data)
        except WireFormatError as error:
            self._findings.malformed += 1
            version = self._settings.version.value
            self._findings.complain(f"no command of FRI {version}: {error}", now)
            return
        header = command.header
        self.reflected = header.sequence
        arrival = self.ledger.receive(header.sequence, header.reflected, at_ns)
        if not arrival.usable:
            self._findings.complain(_WRONG[arrival], now)
        elif session.commanding and self._was_asked(header.reflected):
            self._take(command, now, active=session.active)

    def _was_asked(self, reflected: int) -> bool:
        """Say whether a packet asked for commands; the answers to earlier ones do not count."""
        return (reflected - self._asked_from) % _COUNTERS < _COUNTERS // 2

    def _take(self, command: Command, now: float, *, active: bool) -> None:
        wanted, complaint = self._judge.read(command.data)
        if not complaint:
            self._findings.command(wanted)
            if not active:
                complaint = self._judge.confirms(wanted, self._motion.ipo)
        if complaint:
            self.confirmed = 0
            self._findings.complain(complaint, now)
            return
        if not active:
            self.confirmed += 1
        elif not self.stop:
            self._follow(wanted, now)

    def _follow(self, wanted: Wanted, now: float) -> None:
        """Let the arm follow a command, or stop it.

        Several in one interval have no more time than one: answers that pile up are a jump.
        """
        since = (self._before, self._intervals)
        self._findings.step(self._judge.share_of_step(wanted, *since))
        if stop := self._judge.stops(wanted, *since):
            self.stop, self._stop_until = stop, now + self._settings.times.stop
            self._findings.stop(stop, now)
            return
        self._motion.take(wanted)
        self._followed = True
