"""The simulated controller: one loop that speaks first, listens, judges, and moves the arm."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.fri.controller.arm import ControlledArm
from backends.fri.controller.judge import CommandJudge, Wanted
from backends.fri.controller.ledger import Ledger
from backends.fri.controller.link import Channel
from backends.fri.controller.monitoring import MonitoringWriter, Standing
from backends.fri.controller.path import SetpointPath
from backends.fri.controller.port import Port
from backends.fri.controller.quality import ConnectionQuality
from backends.fri.controller.report import ControllerReport, Findings
from backends.fri.controller.scenario import Now, Scenario, ScenarioClock
from backends.fri.controller.session import Circumstances, Session
from backends.fri.messages import JOINTS, ControlMode, SafetyState, SessionState
from backends.fri.template import CommandTemplate
from limo_driver.closing import Closing
from limo_driver.errors import WireFormatError
from limo_driver.realtime import Pace, Realtime, sleeper

if TYPE_CHECKING:
    from backends.fri.controller.settings import ControllerSettings
    from backends.fri.messages import Command
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

WIND_DOWN: Final = 0.1  # [s] in MONITORING_READY before the session is closed
FAREWELL: Final = 10  # packets in IDLE, by which clients know that it is over
GRACE: Final = 0.05  # [s] for answers that are still under way at the end
TRACKING: Final = 0.05  # [rad] off the set-point at which the tracking performance is 0
_MOST_STEPS: Final = 200  # [ms] that are simulated at once after a pause of the whole process
_HALF: Final = 1 << 31  # counters further apart have wrapped


class SimulatedController(Closing):
    """An arm in MuJoCo behind FRI on UDP; the constructor binds the port.

    Args:
        settings: What it is set to.
        simulation: Arm and effects; the iiwa without effects if None.
        scenario: What goes wrong when.

    Raises:
        ConfigError: The port cannot be bound, or the arm has not seven joints.
    """

    def __init__(
        self,
        settings: ControllerSettings,
        simulation: Simulation | None = None,
        scenario: Scenario | None = None,
    ) -> None:
        scenario = Scenario() if scenario is None else scenario
        self.settings = settings
        self.client = settings.client.resolved()
        self.findings = Findings()
        period, interval = 1e-3 * settings.period_ms, 1e-3 * settings.interval_ms
        self._arm = ControlledArm(simulation, settings.compliance, settings.position, settings.seed)
        limits = self._arm.spec.limits
        start = np.array(settings.position)
        self._path = SetpointPath(start, limits.acceleration, settings.interval_ms)
        self._state = self._arm.advance(start[None])
        self._judge = CommandJudge(settings.mode, limits, settings.limits, interval)
        self._quality = ConnectionQuality(settings.quality, interval)
        self._session = Session(settings.times)
        late = settings.late_after
        self._ledger = Ledger(settings.multiplier, None if late is None else round(1e9 * late))
        self._writer = MonitoringWriter(
            settings.version,
            settings.mode,
            settings.period_ms,
            settings.multiplier,
            self._arm.nominal,
        )
        self._commands = CommandTemplate(settings.version)
        self._clock = ScenarioClock(scenario)
        self._now = Now()
        self._outgoing = Channel("to_client", scenario.seed)
        self._incoming = Channel("to_robot", scenario.seed)
        self._arrived: dict[bytes, int] = {}
        self._pace = Pace(period)
        self._sleep = sleeper()
        self._time = 0.0  # [s] of the robot
        self._cycles = 1  # that the last wait took
        self._ends = float("inf") if settings.duration is None else settings.duration
        self._farewells = 0
        self._confirmed = 0
        self._asked_from = 0  # counter of the first packet that asks for commands
        self._reflected = 0
        self._intervals = 0  # since the last command that counted
        self._command = Wanted()  # in force
        self._fresh: FloatArray | None = None  # position of a command that came since
        self._ipo_base = start
        self._stop_text, self._stop_until = "", 0.0
        self._last_quality = self._quality.level
        self._port = Port(settings.bind)

    @property
    def address(self) -> str:
        """Where the controller listens."""
        return str(self._port.address)

    def stop(self) -> None:
        """End the session in order, soon; may be called from a signal handler."""
        self._ends = min(self._ends, self._time + WIND_DOWN)

    def run(self) -> ControllerReport:
        """Serve the client until the duration is over or `stop` is called.

        Returns:
            What happened.

        Raises:
            BackendError: There is no way to the client's host.
        """
        with Realtime(fifo=self.settings.fifo) as realtime:
            while self._farewells < FAREWELL:
                self._wait()
                self._cycle()
                realtime.tidy()
            self._linger()
            notes = tuple(realtime.refused)
        return self._report(notes)

    def close(self) -> None:
        """Close the port and let go of the arm."""
        self._port.close()
        self._arm.close()

    def _wait(self) -> None:
        """Sleep until the next cycle; datagrams that were delayed go out when they are due."""
        due = self._pace.next_ns()
        while (leaving := self._outgoing.next_ns()) is not None and leaving < due:
            self._sleep(leaving)
            self._send_due(leaving)
        skipped = self._pace.skipped
        self._pace.wait()
        self._cycles = 1 + self._pace.skipped - skipped

    def _cycle(self) -> None:
        self._now = self._clock.at(self._time)
        self._listen()
        self._close_interval()
        self._update_session()
        self._move()
        if not self._now.silent:
            self._speak()
        if self._time >= self._ends and self._session.state is SessionState.IDLE:
            self._farewells += 1
        self._time += self._cycles * 1e-3 * self.settings.period_ms

    def _listen(self) -> None:
        """Take the answers that have come, by now, through the network of the scenario."""
        for datagram in self._port.received():
            if datagram.sender != self.client:
                self.findings.strangers += 1
                self.findings.complain(
                    f"a datagram came from {datagram.sender}, not from the client "
                    f"{self.client}: it is ignored",
                    self._time,
                )
                continue
            self._incoming.put(datagram.data, datagram.at_ns, self._now.to_robot)
        for data, at_ns in self._incoming.take(time.monotonic_ns()):
            self._answer(data, at_ns)

    def _answer(self, data: bytes, at_ns: int) -> None:
        try:
            command = self._commands.decode(data)
        except WireFormatError as error:
            self.findings.malformed += 1
            self.findings.complain(f"no command of FRI {self.settings.version.value}: {error}",
                                   self._time)  # fmt: skip
            return
        header = command.header
        self._reflected = header.sequence
        arrival = self._ledger.receive(header.sequence, header.reflected, at_ns)
        if not arrival.usable:
            self.findings.complain(
                "an answer reflects a packet that was answered before or was not to be answered"
                if arrival.value == "repeated"
                else "an answer reflects a packet that was never sent, or long ago",
                self._time,
            )
        elif self._session.commanding and self._was_asked(header.reflected):
            self._take(command)

    def _was_asked(self, reflected: int) -> bool:
        return (reflected - self._asked_from) % (2 * _HALF) < _HALF

    def _take(self, command: Command) -> None:
        """Judge a command of a client that was asked for one."""
        wanted, complaint, _ = self._judge.read(command.data)
        if complaint:
            self._confirmed = 0
            self.findings.complain(complaint, self._time)
            return
        self.findings.command(wanted)
        if not self._session.active:
            complaint = self._judge.confirms(wanted, self._ipo())
            self._confirmed = 0 if complaint else self._confirmed + 1
            if complaint:
                self.findings.complain(complaint, self._time)
            return
        if self._stop_text:
            return
        before = self._command.position
        stop = self._judge.stops(
            wanted, self._path.position if before is None else before, self._intervals
        )
        if stop:
            self._stop_text = stop
            self._stop_until = self._time + self.settings.times.stop
            self.findings.stop(stop, self._time)
            return
        if wanted.position is None:
            wanted = wanted._replace(position=self._ipo())
        self._command, self._fresh, self._intervals = wanted, wanted.position, 0

    def _close_interval(self) -> None:
        answered = self._ledger.close_interval()
        if answered is None:
            return
        self._intervals += 1
        self._quality.count(answered=answered)
        if self._session.commanding and not answered and not self._session.active:
            self._confirmed = 0

    def _update_session(self) -> None:
        before = self._session.state
        if self._stop_text and self._time >= self._stop_until:
            self._stop_text = ""
        cap, reason = self._cap()
        if self._session.state is not SessionState.IDLE:
            self._last_quality = min(self._quality.level, self._now.quality)
        after = self._session.update(
            self._time,
            Circumstances(self._last_quality, self._confirmed, cap, reason, self._why_stopped()),
        )
        if after is before:
            return
        if before >= SessionState.COMMANDING_WAIT > after:
            self._release()
        elif after is SessionState.COMMANDING_WAIT:
            self._ask()
        elif after is SessionState.COMMANDING_ACTIVE:
            self._command, self._fresh, self._intervals = Wanted(), None, 0
        if before is SessionState.IDLE:
            self._quality.reset()

    def _cap(self) -> tuple[SessionState, str]:
        """Return the highest state that the program and the scenario allow, and why."""
        caps = [(self._now.session, "the scenario says so")]
        if self._time >= self._ends:
            caps.append((SessionState.IDLE, "the program is over"))
        elif self._time >= self._ends - WIND_DOWN:
            caps.append((SessionState.MONITORING_READY, "the program is over"))
        if self.settings.monitoring_only:
            caps.append((SessionState.MONITORING_READY, self.settings.monitoring_only))
        return min(caps, key=lambda cap: cap[0])

    def _why_stopped(self) -> str:
        if self._now.safety is not SafetyState.NORMAL:
            return f"safety stop {self._now.safety.name}"
        return self._stop_text

    def _ask(self) -> None:
        """Ask the client for commands, under the control that its mode needs."""
        self._confirmed = 0
        self._asked_from = self._ledger.next_sequence
        self._ipo_base = self._path.position - self._program()
        if self.settings.control is not ControlMode.POSITION:
            self._arm.take_control(self.settings.control, self._path.position)

    def _release(self) -> None:
        """Brake, and control the position from where the arm is."""
        self._command = Wanted()
        if self._arm.control is not ControlMode.POSITION:
            self._path.rest_at(self._state.position, self._state.velocity)
            self._arm.take_control(ControlMode.POSITION, self._state.position)
        else:
            self._path.rest_at(self._path.position, self._path.velocity)

    def _move(self) -> None:
        steps = min(self._cycles * self.settings.period_ms, _MOST_STEPS)
        if self._session.active:
            targets = self._path.follow(self._fresh, steps)
            self._fresh = None
        else:
            targets = self._path.rest(self._program(), steps)
        push = np.zeros(JOINTS)
        for event in self._now.pushes:
            push[event.joint - 1] += event.torque
        self._arm.push(push)
        self._state = self._arm.advance(targets, self._command.torque, self._command.wrench)

    def _program(self) -> FloatArray:
        """Return how far the robot's program has moved the joints at this moment, (7,) [rad]."""
        offset = np.zeros(JOINTS)
        for event in self._now.motions:
            phase = 2.0 * np.pi * (self._time - event.at) / event.duration
            offset[event.joint - 1] += 0.5 * event.amplitude * (1.0 - np.cos(phase))
        return offset

    def _ipo(self) -> FloatArray:
        """Return the set-point of the robot's own program, (7,) [rad]."""
        return self._ipo_base + self._program()

    def _speak(self) -> None:
        session = self._session
        idle = session.state is SessionState.IDLE
        off = float(np.abs(self._path.position - self._state.position).max())
        overlay = self._command.torque
        torque = self._state.model_torque
        packet = self._writer.write(
            self._ledger.next_sequence,
            self._reflected,
            Standing(
                session=session.state,
                quality=self._last_quality,
                safety=self._shown_safety(),
                control=self._arm.control,
                arm=self._state,
                setpoint=self._path.position,
                ipo=self._ipo() if session.commanding else self._path.position,
                commanded_torque=torque if overlay is None else torque + overlay,
                tracking=max(1.0 - off / TRACKING, 0.0) if session.active else 0.0,
            ),
        )
        self.findings.rate(self._last_quality)
        now = time.monotonic_ns()
        self._ledger.send(now, expects_answer=not idle)
        self._outgoing.put(packet, now, self._now.to_client)
        self._send_due(now)

    def _shown_safety(self) -> SafetyState:
        if self._now.safety is SafetyState.NORMAL and self._stop_text:
            return SafetyState.STOP0_OR_1
        return self._now.safety

    def _send_due(self, now_ns: int) -> None:
        for packet, _ in self._outgoing.take(now_ns):
            self._port.send(packet, self.client)

    def _linger(self) -> None:
        """Count answers that are still under way."""
        self._sleep(time.monotonic_ns() + round(1e9 * GRACE))
        self._now = Now()
        self._listen()

    def _report(self, notes: tuple[str, ...]) -> ControllerReport:
        settings, pace = self.settings, self._pace
        loop: dict[str, Any] = pace.lateness.as_json() | {"skipped": pace.skipped}
        more = [settings.monitoring_only] if settings.monitoring_only else []
        if self._port.unsent:
            more.append(f"{self._port.unsent} datagrams unsent: {self._port.last_refusal}")
        return ControllerReport(
            version=settings.version.value,
            client=str(self.client),
            bound=self.address,
            mode=settings.mode.name.lower(),
            period_ms=settings.period_ms,
            multiplier=settings.multiplier,
            duration=self._time,
            ledger=self._ledger,
            visits=tuple(self._session.visits),
            quality=self._last_quality,
            findings=self.findings,
            fates={"to_client": self._outgoing.fates, "to_robot": self._incoming.fates},
            loop=loop,
            loop_text=pace.summary(),
            notes=(*notes, *more),
        )
