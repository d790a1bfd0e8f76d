"""The simulated controller: one loop that speaks first, listens, judges, and moves the arm."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from backends.fri.codec.messages import SafetyState, SessionState
from backends.fri.simulator.connection.port import Channel, ConnectionQuality, UdpPort
from backends.fri.simulator.listener import CommandedArm, Listener
from backends.fri.simulator.report import ClientObservations, ControllerReport
from backends.fri.simulator.scenario import ControllerScenario, Exchange, Now, ScenarioClock
from backends.fri.simulator.session import (
    Circumstances,
    ControllerSession,
    ControllerVisit,
    MonitoringWriter,
    Standing,
)
from limo_driver.robot.realtime import Pace, Realtime, sleeper
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from backends.fri.simulator.arm import ArmState
    from backends.fri.simulator.session import ControllerSettings
    from limo_driver.physics import Simulation

WIND_DOWN: Final = 0.1  # [s] in MONITORING_READY before the session is closed
FAREWELL: Final = 10  # packets in IDLE, by which clients know that it is over
GRACE: Final = 0.05  # [s] for answers that are still under way at the end


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
        scenario: ControllerScenario | None = None,
    ) -> None:
        scenario = ControllerScenario() if scenario is None else scenario
        self.settings = settings
        self.client = settings.client.resolved()
        self.findings = ClientObservations()
        self._motion = CommandedArm(settings, simulation)
        self._listener = Listener(settings, self.client, scenario.seed, self.findings, self._motion)
        self._ledger = self._listener.ledger
        self._network = Channel("to_client", scenario.seed)
        self._quality = ConnectionQuality(settings.quality, 1e-3 * settings.interval_ms)
        self._level = self._quality.level  # as it is shown
        self._session = ControllerSession(settings.times)
        self._writer = MonitoringWriter(
            settings.version,
            settings.mode,
            settings.period_ms,
            settings.multiplier,
            self._motion.arm.nominal,
            self._listener.signals.requested(settings.version.generation),
        )
        self._clock = ScenarioClock(scenario)
        self._now = Now()
        self._pace = Pace(1e-3 * settings.period_ms)
        self._sleep = sleeper()
        self._began_ns = time.time_ns()
        self._time = 0.0  # [s] of the robot
        self._ends = float("inf") if settings.duration is None else settings.duration
        self._farewells = 0
        self._packet()  # what is compiled and learned at first is not at the client's cost
        self._port = UdpPort(settings.bind)

    @property
    def address(self) -> str:
        """Address on which the controller listens."""
        return str(self._port.address)

    @property
    def visits(self) -> tuple[ControllerVisit, ...]:
        """The session states so far, when each was entered, and why where that was a loss."""
        return tuple(self._session.visits)

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
                # Sleep until the next cycle; datagrams that were delayed go out when they are due
                due = self._pace.next_ns()
                while (leaving := self._network.next_ns()) is not None and leaving < due:
                    self._sleep(leaving)
                    self._send_due(leaving)
                self._pace.wait()  # of periods that are missed, arm and clock know nothing
                self._cycle()
                realtime.tidy()
            # Count answers that are still under way
            self._sleep(time.monotonic_ns() + round(1e9 * GRACE))
            heard_ns = time.monotonic_ns()
            self._listener.listen(self._port, self._time, Now().to_robot, self._session)
            self._listener.close_interval(heard_ns)
            notes = tuple(realtime.refused)
        return self._report(notes)

    def close(self) -> None:
        """Close the port and let go of the arm."""
        self._port.close()
        self._motion.arm.close()

    def _cycle(self) -> None:
        heard_ns = time.monotonic_ns()
        self._now = self._clock.at(self._time)
        self._listener.listen(self._port, self._time, self._now.to_robot, self._session)
        for answered in self._listener.close_interval(heard_ns):
            self._quality.count(answered=answered)
        self._update_session()
        steps = self.settings.period_ms
        self._motion.move(
            self._now, self._clock.since(self._time), steps, active=self._session.active
        )
        if self._now.silent:
            self._listener.disturb()
        else:
            packet, state = self._packet(), self._session.state
            self.findings.rate(self._level)
            now = time.monotonic_ns()
            disturbed = self._network.put(packet, now, self._now.to_client)
            self._send_due(now)
            self._ledger.send(
                time.monotonic_ns(), expects_answer=state is not SessionState.IDLE, state=state
            )
            if disturbed:
                self._ledger.disturb()
                self._listener.disturb()
        if self._time >= self._ends and self._session.state is SessionState.IDLE:
            self._farewells += 1
        self._time += 1e-3 * steps

    def _update_session(self) -> None:
        before = self._session.state
        if before is not SessionState.IDLE:
            self._level = min(self._quality.level, self._now.quality)
        # The highest state that the program and the scenario allow, and why
        caps = [(self._now.session, "the scenario says so")]
        if self._time >= self._ends:
            caps.append((SessionState.IDLE, "the program is over"))
        elif self._time >= self._ends - WIND_DOWN:
            caps.append((SessionState.MONITORING_READY, "the program is over"))
        if self.settings.monitoring_only:
            caps.append((SessionState.MONITORING_READY, self.settings.monitoring_only))
        cap, reason = min(caps, key=lambda cap: cap[0])
        given = Circumstances(
            self._level, self._listener.confirmed, cap, reason, self._why_stopped()
        )
        after = self._session.update(self._time, given)
        if after is before:
            return
        if before is SessionState.IDLE:
            self._quality.reset()
        if before >= SessionState.COMMANDING_WAIT > after:
            self._motion.release()
        elif after is SessionState.COMMANDING_WAIT:
            self._motion.ask()
            self._listener.ask()
        elif after is SessionState.COMMANDING_ACTIVE:
            self._motion.begin()
            self._listener.begin()
            self._clock.begin_commanding(self._time)

    def _why_stopped(self) -> str:
        if self._now.safety is not SafetyState.NORMAL:
            return f"safety stop {self._now.safety.name}"
        return self._listener.stop

    def _packet(self) -> bytes:
        session, motion = self._session, self._motion
        safety = self._now.safety
        if safety is SafetyState.NORMAL and self._listener.stop:
            safety = SafetyState.STOP0_OR_1
        return self._writer.write(
            self._ledger.next_sequence,
            self._listener.reflected,
            Standing(
                # as even as the motion is: not when this process came to write it
                stamp_ns=self._began_ns + round(1e9 * self._time),
                session=session.state,
                quality=self._level,
                safety=safety,
                control=motion.arm.control,
                arm=reported(motion.state, self._now.exchanges),
                setpoint=motion.path.position,
                ipo=motion.ipo,
                commanded_torque=motion.commanded_torque,
                tracking=motion.tracking if session.active else 0.0,
                ios=self._listener.signals.ios,
            ),
        )

    def _send_due(self, now_ns: int) -> None:
        for packet in self._network.take(now_ns):
            self._port.send(packet.data, self.client)

    def _report(self, refused: tuple[str, ...]) -> ControllerReport:
        settings, pace = self.settings, self._pace
        loop: dict[str, Any] = pace.lateness.as_json() | {"skipped": pace.skipped}
        notes = [*refused, settings.monitoring_only]
        if self._port.unsent:
            notes.append(f"{self._port.unsent} datagrams unsent: {self._port.last_refusal}")
        return ControllerReport(
            settings=settings,
            client=str(self.client),
            bound=self.address,
            duration=self._time,
            ledger=self._ledger,
            visits=self.visits,
            quality=self._level,
            findings=self.findings,
            signals=self._listener.signals,
            fates={"to_client": self._network.fates, "to_robot": self._listener.network.fates},
            loop=loop,
            loop_text=pace.summary(),
            notes=tuple(note for note in notes if note),
        )


def reported(state: ArmState, exchanges: tuple[Exchange, ...]) -> ArmState:
    """Return what an arm reports whose joints are exchanged, as its cables may be."""
    for each in exchanges:
        order = list(range(len(state.position)))
        i, j = each.joint - 1, each.other - 1
        order[i], order[j] = j, i
        state = replace(state, **{name: values[order] for name, values in vars(state).items()})
    return state
