"""The controller's ear: what comes is counted, read, judged, and passed on if it may.

A complaint that the scenario's network may have caused is marked as such: one more answer to a
packet that was doubled, or a jump within ten intervals of a datagram that was lost or late.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

import numpy as np

from backends.fri.codec.messages import JOINTS, Command, ControlMode, SessionState
from backends.fri.codec.template import CommandTemplate
from backends.fri.simulator.arm import ControlledArm, SetpointPath
from backends.fri.simulator.connection.port import Address, Channel, Delivered, Disturbance, UdpPort
from backends.fri.simulator.judge import (
    MOST_INTERVALS,
    CommandJudge,
    Signals,
    Wanted,
    display_name,
    monitored_as_of,
)
from backends.fri.simulator.report import Arrival, ClientObservations, Ledger
from backends.fri.simulator.scenario import FlangeForce, HandGuiding, Now
from limo_driver.errors import WireFormatError

if TYPE_CHECKING:
    from backends.fri.simulator.session import ControllerSession, ControllerSettings
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

_COUNTERS: Final = 1 << 32
_MONITORED: Final = {SessionState.MONITORING_WAIT, SessionState.MONITORING_READY}
_WRONG: Final = {
    Arrival.REPEATED: "an answer reflects a packet that was answered before",
    Arrival.UNKNOWN: "an answer reflects a packet that was never sent, or long ago",
}
TRACKING: Final = 0.05  # [rad] off the set-point at which the tracking performance is 0


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
            fault = (
                display_name(datagram.data, version)
                or f"no command of FRI {version.value}: {error}"
            )
            self._findings.complain(fault, now)
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
            fault := monitored_as_of(command, version)
        ):
            self._findings.complain(fault, now)
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


class CommandedArm:
    """The arm, its set-point, and who moves it.

    Args:
        settings: Of the controller.
        simulation: Arm and effects; the iiwa without effects if None.
    """

    def __init__(self, settings: ControllerSettings, simulation: Simulation | None) -> None:
        self._settings = settings
        start = np.array(settings.position, dtype=float)
        self.arm = ControlledArm(simulation, settings.compliance, settings.position, settings.seed)
        self.limits = self.arm.spec.limits
        self.path = SetpointPath(start, self.limits.acceleration, settings.interval_ms)
        self.state = self.arm.advance(start[None])
        self.program = np.zeros(JOINTS)  # how far the robot's own program has moved, (7,) [rad]
        self._ipo_base = start
        self._guide: tuple[HandGuiding | None, FloatArray] = None, start  # and where it began [rad]
        self.begin()

    @property
    def ipo(self) -> FloatArray:
        """Set-point of the robot's own program, (7,) [rad]."""
        return self._ipo_base + self.program

    @property
    def commanded(self) -> FloatArray:
        """Position that was commanded last, (7,) [rad]."""
        return self.path.position if self._command.position is None else self._command.position

    @property
    def commanded_torque(self) -> FloatArray:
        """Torque of the robot's model at this motion, and what the client adds, (7,) [N m]."""
        overlay = self._command.torque
        return self.state.model_torque + (0.0 if overlay is None else overlay)

    @property
    def tracking(self) -> float:
        """How closely the arm follows: 1 on the set-point, 0 at 50 mrad (limo's model)."""
        off = float(np.abs(self.path.position - self.state.position).max())
        return max(1.0 - off / TRACKING, 0.0)

    def ask(self) -> None:
        """Prepare for commands, under the control that they need; earlier ones are over."""
        self.begin()
        if self._settings.control is not ControlMode.POSITION:
            self.arm.take_control(self._settings.control, self.path.position)

    def begin(self) -> None:
        """Let the client's commands count from now on."""
        self._command = Wanted()
        self._fresh: FloatArray | None = None  # position of a command that came since

    def take(self, wanted: Wanted) -> None:
        """Follow a command; one without a position is laid over the program's own."""
        if wanted.position is None:
            wanted = wanted._replace(position=self.ipo)
        self._command, self._fresh = wanted, wanted.position

    def release(self) -> None:
        """Brake, and control the position from where the arm is."""
        self.begin()
        if self.arm.control is ControlMode.POSITION:
            self.path.rest_at(self.path.position, self.path.velocity)
        else:
            self.path.rest_at(self.state.position, self.state.velocity)
            self.arm.take_control(ControlMode.POSITION, self.state.position)

    def _guided(self, guide: HandGuiding, time: float) -> FloatArray:
        """Return where a hand has the arm, (7,) [rad], on its smooth way."""
        if self._guide[0] is not guide:
            self._guide = guide, self.path.position
        start, u = self._guide[1], min((time - guide.at) / (0.9 * guide.duration), 1.0)
        return start + (np.array(guide.position) - start) * u**3 * (10.0 - 15.0 * u + 6.0 * u**2)

    def move(self, now: Now, time: float, steps: int, *, active: bool) -> None:
        """Move the arm for some milliseconds.

        Args:
            now: Who pushes it, and what its program does.
            time: Of the scenario [s].
            steps: Milliseconds.
            active: Whether the client's commands count.
        """
        push, self.program = np.zeros(JOINTS), np.zeros(JOINTS)
        for event in now.pushes:
            if isinstance(event, FlangeForce):
                push += self.arm.torque_of(np.array(event.force))
            else:
                push[event.joint - 1] += event.torque
        for event in now.motions:
            phase = 2.0 * np.pi * (time - event.at) / event.duration
            self.program[event.joint - 1] += 0.5 * event.amplitude * (1.0 - np.cos(phase))
        self.arm.push(push)
        if now.guide is not None and not active:
            targets = self.path.guide(self._guided(now.guide, time), steps)
            self._ipo_base = self.path.position
        elif active:
            targets, self._fresh = self.path.follow(self._fresh, steps), None
        else:
            targets = self.path.rest(self.program, steps)
            self._ipo_base = self.path.position - self.program  # also while it still brakes
        self.state = self.arm.advance(targets, self._command.torque, self._command.wrench)
