"""Station: all drives of an arm on one bus, the arm behind them, and what goes wrong on the way."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.can import port as frames
from backends.can.config import CIA402, Cia402Joint
from backends.can.simulator.arm import SimulatedArm
from backends.can.simulator.cia402_drive import Cia402Drive
from backends.can.simulator.damiao_drive import DamiaoDrive
from backends.can.simulator.scenario import (
    FROM_DRIVES,
    SWITCHED_ON,
    TO_DRIVES,
    BusScenario,
    Guide,
    rewired,
)
from limo_driver.errors import ConfigError
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from backends.can.config import ArmConfig, Joint
    from backends.can.port import BusPort
    from backends.can.simulator.drive import JointPort, SimulatedDrive
    from backends.can.simulator.scenario import Fault
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

TICK: Final = 2e-3  # [s] after which time passes for the drives, whether or not frames come


@dataclass
class StationCounts:
    """Counts of what happened on the bus so far."""

    heard: int = 0  # frames of others
    sent: int = 0
    lost: int = 0  # by the scenario, on the way to a drive or from it
    babbled: int = 0
    syncs: int = 0
    faults: list[str] = field(default_factory=list)  # begun, in order of time

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


class Station(Closing):
    """Simulated drives as participants of a bus.

    Args:
        config: The arm; every drive is as its joint says.
        port: The bus, closed with the station.
        simulation: Arm and effects behind the drives.
        position: Where the arm stands at first, (n,) [rad]; the middle of its range if not given.
        seed: Of the sensor noise.
        scenario: What goes wrong.
        clock: Says what time it is [s].
    """

    def __init__(
        self,
        config: ArmConfig,
        port: BusPort,
        simulation: Simulation,
        position: Sequence[float] | FloatArray | None = None,
        seed: int = 0,
        scenario: BusScenario | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._config, self._port, self._clock = config, port, clock
        self._scenario = scenario or BusScenario()
        self.counts = StationCounts()
        self.arm = SimulatedArm(simulation, position, seed)
        self._random = np.random.default_rng(self._scenario.seed)
        ordered = sorted(self._scenario.faults, key=lambda fault: fault.at)
        self._waiting = [fault for fault in ordered if not isinstance(fault, Guide)]
        self._guides = [fault for fault in ordered if isinstance(fault, Guide)]
        self._guided_from = self.arm.encoders  # (n,) [rad]
        self._active: list[Fault] = []
        self._began: float | None = None  # from when times of the scenario count [s]
        self._ticked = self._started = 0.0
        self.drives: tuple[SimulatedDrive, ...] = tuple(
            self._drive(number, joint, port)
            for number, (joint, port) in enumerate(
                zip(rewired(config.joints, self._scenario.faults), self.arm.joints, strict=True),
                start=1,
            )
        )

    def start(self) -> None:
        """Switch the drives on."""
        self._ticked = self._started = self._clock()
        if self._scenario.origin == SWITCHED_ON:
            self._began = self._started
        for drive in self.drives:
            drive.start(self._ticked)

    def run(self, stopped: Callable[[], bool]) -> None:
        """Be on the bus until told to stop."""
        self.start()
        while not stopped():
            self.turn()

    @property
    def due(self) -> float:
        """When time has to pass next [s], by the clock."""
        return self._ticked + TICK

    def turn(self) -> None:
        """Hear what comes within a tick, then let time pass."""
        until = self.due
        while True:
            frame = self._port.receive(until)
            now = self._clock()
            if frame is not None:
                self.hear(frame.id, frame.data)
            if now >= until:
                break
        self._tick(now)

    def close(self) -> None:
        """Leave the bus."""
        self._port.close()

    def hear(self, frame_id: int, data: bytes) -> None:
        """Take a frame from the bus."""
        now = self._clock()
        self.counts.heard += 1
        is_sync = frame_id == frames.SYNC and self._config.convention == CIA402
        for number, drive in enumerate(self.drives, start=1):
            if self._active and self._loses(number, TO_DRIVES):
                continue
            if is_sync:
                drive.synchronise(now)
            else:
                drive.hear(frame_id, data, now)
        if is_sync:
            self.counts.syncs += 1
            period = self._period
            self._demand(period)
            self.arm.synchronise(period, now)

    def _tick(self, now: float) -> None:
        elapsed, self._ticked = now - self._ticked, now
        self._guide(now - self._started)
        for drive in self.drives:
            drive.tick(now)
        for _ in range(self.arm.periods_due(self._period, now)):
            self._demand(self._period)
            self.arm.move_on(self._period)
        if self._began is None and any(drive.enabled for drive in self.drives):
            self._began = now
        if self._began is not None:
            self._play(now - self._began, elapsed)

    def _guide(self, elapsed: float) -> None:
        """Let a hand move the arm."""
        if self._guides and elapsed >= self._guides[0].at:
            guide = self._guides[0]
            self.arm.guided = guide.on_way(self._guided_from, elapsed)
            if elapsed >= guide.ends:
                self._guided_from = self.arm.guided
                del self._guides[0]

    def _demand(self, period: float) -> None:
        for drive in self.drives:
            drive.demand(period)

    @property
    def _period(self) -> float:
        """Return by how much time the arm is moved on at once [s]."""
        if self._config.convention != CIA402:
            return TICK
        return max(drive.period for drive in self.drives) or 1.0 / self._config.rate

    def _play(self, since: float, elapsed: float) -> None:
        """Let faults begin, disturb and end."""
        while self._waiting and self._waiting[0].at <= since:
            fault = self._waiting.pop(0)
            self.counts.faults.append(fault.name)
            self._active.append(fault)
            fault.begin(self.drives)
        for fault in [fault for fault in self._active if fault.ends <= since]:
            self._active.remove(fault)
            fault.end(self.drives)
        for fault in self._active:
            fault.disturb(elapsed, self._babble)

    def _loses(self, number: int, way: str) -> bool:
        lost = any(fault.loses(number, way, self._random) for fault in self._active)
        self.counts.lost += lost
        return lost

    def _sender(self, number: int) -> Callable[[int, bytes], None]:
        def send(frame_id: int, data: bytes) -> None:
            if self._active and self._loses(number, FROM_DRIVES):
                return
            self.counts.sent += 1
            self._port.send(frame_id, data)

        return send

    def _babble(self, frame_id: int, data: bytes) -> None:
        self.counts.babbled += 1
        self._port.send(frame_id, data)

    def _drive(self, number: int, joint: Joint, port: JointPort) -> SimulatedDrive:
        send = self._sender(number)
        if isinstance(joint, Cia402Joint):
            return Cia402Drive(number, joint, port, send, self._config.temperature)
        limit = float(self._config.model.limits.torque[number - 1])
        if not 0.0 < limit < math.inf:
            raise ConfigError(
                f"no torque limit of joint {number} is stated in {self._config.robot}, from which "
                "a simulated Damiao motor has the range of its torque (register 23)"
            )
        return DamiaoDrive(joint, limit, port, send)
