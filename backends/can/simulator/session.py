"""One run of simulated drives, from opening the bus to the signal that ends it."""

from __future__ import annotations

import math
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final

from backends.can.cia402 import sdo
from backends.can.cia402.discovery import DEVICE_TYPE
from backends.can.config import Cia402Joint
from backends.can.damiao import codec as damiao
from backends.can.frames import SDO_REPLY, SDO_REQUEST
from backends.can.port import BusPort
from backends.can.simulator.station import Station
from limo_driver.errors import BackendError, ConfigError
from limo_driver.robot.interrupts import interrupts
from limo_driver.robot.realtime import Realtime
from limo_driver.types import same_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from backends.can.config import ArmConfig, Joint
    from backends.can.simulator.scenario import BusScenario
    from backends.can.simulator.station import StationCounts
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

ANSWER_TIME: Final = 0.1  # [s] in which drives answer that are there already


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
