"""A bus of simulated drives, in this process or in one of its own.

Station: all drives of an arm on one bus, the arm behind them, and what goes wrong on the way.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from backends.can import port as frames
from backends.can.cia402 import sdo
from backends.can.cia402.sdo import DEVICE_TYPE
from backends.can.config import CIA402, ArmConfig, Cia402Joint, Joint
from backends.can.damiao import codec as damiao
from backends.can.port import SDO_REPLY, SDO_REQUEST, BusPort
from backends.can.simulator.arm import SimulatedArm
from backends.can.simulator.cia402_drive import Cia402Drive
from backends.can.simulator.drive import DamiaoDrive
from backends.can.simulator.scenario import (
    FROM_DRIVES,
    SWITCHED_ON,
    TO_DRIVES,
    BusScenario,
    Guide,
    rewired,
)
from limo_driver.errors import BackendError, ConfigError
from limo_driver.robot.interrupts import interrupts
from limo_driver.robot.realtime import Realtime
from limo_driver.runtime.processes import Closing
from limo_driver.types import FloatArray, same_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from backends.can.simulator.drive import JointPort, SimulatedDrive
    from backends.can.simulator.scenario import Fault
    from limo_driver.physics import Simulation

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


ANSWER_TIME: Final = 0.1  # [s] in which drives answer that are there already
ENDING: Final = 120.0  # [s] in which the process has to end once it is told; it may compile
_COMMAND: Final = "from limo_driver.app.cli import main; main()"


def run_drives(
    config: ArmConfig,
    simulation: Simulation,
    ready: Callable[[Sequence[str]], None],
    *,
    fifo: bool = False,
    position: Sequence[float] | FloatArray | None = None,
    seed: int = 0,
    scenario: BusScenario | None = None,
    duration: float | None = None,
) -> StationCounts:
    """Be on the bus until SIGINT, SIGTERM or the end of `duration` [s].

    Args:
        config: The arm.
        simulation: Arm and effects behind the drives.
        ready: Called once the drives can be spoken to, with what the system does not permit.
        fifo: Ask for SCHED_FIFO and locked memory.
        position: Where the arm stands at first, (n,) [rad].
        seed: Of the sensor noise.
        scenario: What goes wrong.
        duration: Time to stay [s]; for ever if not given.

    Returns:
        What happened on the bus.

    Raises:
        ConfigError: The simulation is of another robot.
        BackendError: The bus cannot be opened, or has such drives already.
        ConnectionLostError: It is gone.
    """
    if not same_robot(simulation.model.name, config.model.name):
        raise ConfigError(
            f"the simulation is of {simulation.model.name}, but the drives are of "
            f"{config.model.name}"
        )
    interrupted = threading.Event()
    with (
        interrupts(interrupted.set),
        BusPort(config.bus) as port,
        Station(config, port, simulation, position, seed, scenario) as station,
        ExitStack() as open_,
    ):
        _require_alone(config, port)
        realtime = open_.enter_context(Realtime(fifo=fifo))  # now that everything is loaded
        ends = math.inf if duration is None else time.monotonic() + duration
        station.start()
        ready(realtime.refused)
        while not interrupted.is_set() and time.monotonic() < ends:
            station.turn()
            realtime.tidy()
    return station.counts


def _require_alone(config: ArmConfig, port: BusPort) -> None:
    """Refuse a bus on which these drives are already: every question would have two answers."""
    for joint in config.joints:
        if isinstance(joint, Cia402Joint):
            port.send(SDO_REQUEST + joint.node, sdo.FRAME.pack(sdo.READ, DEVICE_TYPE, 0, b""))
        else:
            port.send(damiao.REGISTERS, damiao.register_frame(joint.node, damiao.REFRESH))
    answers = {_answer_id(joint): joint.node for joint in config.joints}
    until = port.now() + ANSWER_TIME
    while (frame := port.receive(until)) is not None and port.now() < until:
        if (node := answers.get(frame.id)) is not None:
            raise BackendError(
                f"node {node} answers on {port.name} already: end the other drives on this bus "
                "first, or give this arm a bus of its own"
            )


def _answer_id(joint: Joint) -> int:
    return SDO_REPLY + joint.node if isinstance(joint, Cia402Joint) else joint.reply_id


class SimulatedDrives(Closing):
    """Drives on the bus of an `arm.yaml`, ready when the constructor returns.

    Args:
        config: The `arm.yaml`.
        sim: A `sim.yaml`; else the rigid body of the arm alone.
        scenario: What goes wrong.
        trajectory: The arm stands where it starts; in the middle of its range if not given.
        seed: Of the sensor noise.
        fifo: Ask for SCHED_FIFO, where the computer has to keep time for both ends of the bus.

    Raises:
        BackendError: They did not start; says what they said.
    """

    def __init__(
        self,
        config: Path | str,
        *,
        sim: Path | str | None = None,
        scenario: Path | str | None = None,
        trajectory: Path | str | None = None,
        seed: int = 0,
        fifo: bool = False,
    ) -> None:
        options = {"config": config, "sim": sim, "scenario": scenario, "trajectory": trajectory}
        given = [
            word
            for name, value in options.items()
            if value is not None
            for word in (f"--{name}", str(value))
        ]
        given += ["--fifo"] if fifo else []
        self._process = subprocess.Popen(  # noqa: S603  # this interpreter, with our own options
            [sys.executable, "-P", "-c", _COMMAND, "drives", *given, "--seed", str(seed), "--json"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.summary: dict[str, Any] | None = None  # once closed: what happened on the bus
        try:
            stream = self._process.stdout
            started = "" if stream is None else stream.readline()
        except BaseException:
            self.kill()
            raise
        if not started:
            _, said = self._process.communicate()
            raise BackendError(f"the simulated drives did not start: {said.strip()}")

    @property
    def pid(self) -> int:
        """The process."""
        return self._process.pid

    def close(self) -> None:
        """Switch the drives off: the process ends."""
        if self._process.returncode is not None:
            return
        self._process.terminate()
        try:
            said, _ = self._process.communicate(timeout=ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.communicate()
            return
        if lines := said.splitlines():
            self.summary = json.loads(lines[-1])

    def kill(self) -> None:
        """End the process as a cut cable would: at once, without a word."""
        self._process.kill()
        self._process.communicate()
