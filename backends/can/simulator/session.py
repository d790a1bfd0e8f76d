"""A bus of simulated drives, in this process or in one of its own."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Final

from backends.can.cia402 import sdo
from backends.can.cia402.sdo import DEVICE_TYPE
from backends.can.config import ArmConfig, Cia402Joint, Joint
from backends.can.damiao import codec as damiao
from backends.can.port import SDO_REPLY, SDO_REQUEST, BusPort
from backends.can.simulator.station import Station, StationCounts
from limo_driver.errors import BackendError, ConfigError
from limo_driver.robot.interrupts import interrupts
from limo_driver.robot.realtime import Realtime
from limo_driver.runtime.processes import Closing
from limo_driver.types import FloatArray, same_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from backends.can.simulator.scenario import BusScenario
    from limo_driver.physics import Simulation

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
            started = self._read_line()
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

    def _read_line(self) -> str:
        stream = self._process.stdout
        return "" if stream is None else stream.readline()
