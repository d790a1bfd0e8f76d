"""One run of simulated drives, from opening the bus to the signal that ends it."""

from __future__ import annotations

import gc
import math
import signal
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from backends.can.drives.station import Station
from backends.can.port import Port
from limo_driver.errors import ConfigError
from limo_driver.types import same_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from backends.can.config import ArmConfig
    from backends.can.drives.scenario import Scenario
    from backends.can.drives.station import StationCounts
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray


def run_drives(
    config: ArmConfig,
    simulation: Simulation,
    ready: Callable[[], None],
    *,
    position: Sequence[float] | FloatArray | None = None,
    seed: int = 0,
    scenario: Scenario | None = None,
    duration: float | None = None,
) -> StationCounts:
    """Be on the bus until SIGINT, SIGTERM or the end of `duration` [s].

    Args:
        config: The arm.
        simulation: Arm and effects behind the drives.
        ready: Called once the drives can be spoken to.
        position: Where the arm stands at first, (n,) [rad].
        seed: Of the sensor noise.
        scenario: What goes wrong.
        duration: Time to stay [s]; for ever if not given.

    Returns:
        What happened on the bus.

    Raises:
        ConfigError: The simulation is of another robot.
        BackendError: The bus cannot be opened.
        ConnectionLostError: It is gone.
    """
    if not same_robot(simulation.model.name, config.model.name):
        raise ConfigError(
            f"the simulation is of {simulation.model.name}, but the drives are of "
            f"{config.model.name}"
        )
    with (
        _interrupts() as interrupted,
        Port(config.bus) as port,
        Station(config, port, simulation, position, seed, scenario) as station,
    ):
        ends = math.inf if duration is None else time.monotonic() + duration
        station.start()
        gc.collect()
        gc.freeze()  # what is there stays; to go through it again takes longer than a cycle
        ready()
        while not interrupted.is_set() and time.monotonic() < ends:
            station.turn()
    return station.counts


@contextmanager
def _interrupts() -> Generator[threading.Event]:
    """Turn SIGINT and SIGTERM into an event; a second one acts as usual."""
    event = threading.Event()
    numbers = (signal.SIGINT, signal.SIGTERM)
    previous = {number: signal.getsignal(number) for number in numbers}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def note(*_: object) -> None:
        event.set()
        restore()

    for number in previous:
        signal.signal(number, note)
    try:
        yield event
    finally:
        restore()
