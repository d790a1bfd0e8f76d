"""The controller's ear: what comes is counted, read, judged, and passed on if it may.

A complaint that the scenario's network may have caused is marked as such: one more answer to a
packet that was doubled, or a jump within ten intervals of a datagram that was lost or late.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

from backends.fri.codec.messages import SessionState
from backends.fri.codec.template import CommandTemplate
from backends.fri.simulator.client.judge import MOST_INTERVALS, CommandJudge
from backends.fri.simulator.client.ledger import Arrival, Ledger
from backends.fri.simulator.client.signals import Signals
from backends.fri.simulator.client.spoken import monitored_as_of, spoken
from backends.fri.simulator.connection.link import Channel
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from backends.fri.codec.messages import Command
    from backends.fri.simulator.client.judge import Wanted
    from backends.fri.simulator.connection.link import Delivered, Disturbance
    from backends.fri.simulator.connection.port import Address, UdpPort
    from backends.fri.simulator.motion import CommandedArm
    from backends.fri.simulator.report import ClientObservations
    from backends.fri.simulator.session import ControllerSession
    from backends.fri.simulator.settings import ControllerSettings

_COUNTERS: Final = 1 << 32
_MONITORED: Final = {SessionState.MONITORING_WAIT, SessionState.MONITORING_READY}
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
        self.ledger = Ledger(
            settings.multiplier,
            None if late is None else round(1e9 * late),
            period_ns=1_000_000 * settings.period_ms,
        )
        self.network = Channel("to_robot", seed)
        self.reflected = 0  # the client's last counter
        self.confirmed = 0  # answers in a row that confirm the set-point
        self.stop = ""  # why a command stopped the arm; empty if none did lately
        self._stop_until = 0.0  # [s]
        self.signals = Signals(settings.ios, settings.transformations)
        self._calm = MOST_INTERVALS + 1  # intervals since the network last disturbed a datagram
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
            if self.network.put(datagram.data, datagram.at_ns, network):
                self.disturb()
        for datagram in self.network.take(time.monotonic_ns()):
            self._receive(datagram, now, session)

    def disturb(self) -> None:
        """Note that the scenario's network does something to a datagram."""
        self._calm = 0

    def close_interval(self, now_ns: int) -> list[bool]:
        """End the receive interval if it is over.

        Args:
            now_ns: When answers were last listened to [ns].

        Returns:
            Whether it was answered in time, of each interval whose time is over.
        """
        if self.ledger.close_interval():
            self._calm += 1
            if self._followed:
                self.begin()
            else:
                self._intervals += 1
        outcomes = self.ledger.judge(now_ns)
        if not all(outcomes):
            self.confirmed = 0
        return outcomes

    def begin(self) -> None:
        """Measure the steps of commands from where the arm is told to be by now."""
        self._before = self._motion.commanded  # (7,) [rad]
        self._intervals = 1  # that a command has had since
        self._followed = False  # one, in this interval

    def _receive(self, datagram: Delivered, now: float, session: ControllerSession) -> None:
        version = self._settings.version
        try:
            command = self._commands.decode(datagram.data)
        except WireFormatError as error:
            self._findings.malformed += 1
            said = spoken(datagram.data, version) or f"no command of FRI {version.value}: {error}"
            self._findings.complain(said, now)
            return
        header = command.header
        self.reflected = header.sequence
        arrival = self.ledger.receive(header.sequence, header.reflected, datagram.at_ns)
        if not arrival.usable:
            touched = datagram.disturbed or self.ledger.disturbed(header.reflected)
            self._findings.complain(_WRONG[arrival], now, by_scenario=touched)
            return
        for complaint in self.signals.take(command.data):
            self._findings.complain(complaint, now)
        if self.ledger.state_of(header.reflected) in _MONITORED and (
            said := monitored_as_of(command, version)
        ):
            self._findings.complain(said, now)
        if session.commanding and self._was_asked(header.reflected):
            self._take(command, now, active=session.active)

    @property
    def _disturbed(self) -> bool:
        """Whether the scenario's network disturbed a datagram lately."""
        return self._calm <= MOST_INTERVALS or not self.network.empty

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
            mirrors = wanted.position is not None  # but not this set-point, which moves
            self._findings.complain(complaint, now, by_scenario=mirrors and self._disturbed)
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
        share = self._judge.share_of_step(wanted, *since)
        self._findings.step(share)
        if stop := self._judge.stops(wanted, *since):
            self.stop, self._stop_until = stop, now + self._settings.times.stop
            self._findings.stop(stop, now, by_scenario=share > 1.0 and self._disturbed)
            return
        self._motion.take(wanted)
        self._followed = True
