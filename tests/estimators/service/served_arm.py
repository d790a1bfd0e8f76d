"""A simulated arm on a service of its own, state by state, as fast as it goes."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from sessions import wait_until
from wandering import wander

from estimators.service.arm_server import ArmServer
from estimators.service.inference.inbox import Bulletin
from estimators.service.retraining.retraining import Keeper
from estimators.service.settings import ServiceSettings
from estimators.service.store.served_models import StoreModels
from limo_driver.logs.mcap_log import LogLimits, McapLog
from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.network.streaming import Keys, open_session

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.store import ModelStore
    from limo_driver.network.messages import Event
    from limo_driver.physics import Simulation

RATE = 100.0
NAMES = ("shoulder", "elbow")
START = 1_700_000_000_000_000_000  # [ns]
NOISE = 0.02  # [N m]


class NotVetted(StoreModels):
    """A store whose versions are all taken for fit to serve, which spares a process."""

    def vet(self, version: str, demand: object) -> None:
        """Let pass."""


class Arm:
    """Motion without end, and the torque that an arm has in it."""

    def __init__(self, seconds: float, seed: int = 3) -> None:
        t = np.arange(int(seconds * RATE)) / RATE
        self.motion = wander(t, np.array([0.4, -0.8]), seed, (0.1, 0.6), (0.01, 0.05))
        self.noise = NOISE * np.random.default_rng(seed).standard_normal(self.motion.position.shape)
        self.next = 0
        self._codec = JointStateCodec(NAMES, "arm")

    def states(self, physics: Simulation, seconds: float) -> list[tuple[bytes, bytes]]:
        """Return the next joint states of an arm of this physics."""
        rows = slice(self.next, self.next + int(seconds * RATE))
        self.next = rows.stop
        torque = (physics.predict(self.motion) + self.noise)[rows]
        position = self.motion.position[rows]
        return [
            (
                self._codec.encode(START + 10_000_000 * number, q, 0 * q, tau),
                Attachment(number, number).encode(),
            )
            for number, q, tau in zip(range(rows.start, rows.stop), position, torque, strict=True)
        ]


class Served:
    """A server, its keeper, and what they told."""

    def __init__(
        self, server: ArmServer, keeper: Keeper, events: list[Event], log: McapLog
    ) -> None:
        self.server, self.keeper, self.events, self.log = server, keeper, events, log
        self.residual: list[list[float]] = []  # RMS of each second

    @property
    def kinds(self) -> list[str]:
        return [event.kind for event in self.events]

    @property
    def stage(self) -> str:
        return self.keeper.status()["stage"]

    def event(self, kind: str) -> Event:
        return next(event for event in reversed(self.events) if event.kind == kind)

    def feed(self, states: list[tuple[bytes, bytes]]) -> dict[str, Any]:
        """Answer states, and do once a second of them what the service does once a second."""
        status: dict[str, Any] = {}
        for first in range(0, len(states), int(RATE)):
            for payload, attachment in states[first : first + int(RATE)]:
                self.server.service.handle(payload, attachment)
            status = self.server.status()
            self.residual.append(status["external_rms"])
            self.keeper.tick()
        return status

    def sync(self) -> None:
        """Wait until the log is on the disk."""
        wait_until(lambda: not self.log._queue and not self.log._pending)

    def wait_while(self, stage: str, seconds: float = 300.0) -> None:
        """Let a process of its own come to its end."""
        ends = time.monotonic() + seconds
        while self.stage == stage and time.monotonic() < ends:
            self.keeper.tick()
            time.sleep(0.05)
        assert self.stage != stage


@contextmanager
def served(
    store: ModelStore, folder: Path, settings: RetrainingSettings, arm: Arm, physics: Simulation
) -> Generator[Served]:
    """Serve the champion of a store alone on a network, fed by hand, with a log."""
    alone = folder / "alone.json5"
    alone.write_text('{"scouting": {"multicast": {"enabled": false}}}')
    events: list[Event] = []
    limits = LogLimits(queue=1_000_000)
    with open_session(config=alone) as session, McapLog(folder / "logs", "arm", limits) as log:
        models = NotVetted(store)
        bulletin = Bulletin(Keys("arm"), events.append)
        server = ArmServer(session, bulletin, models, ServiceSettings(rate=RATE), log)
        keeper = server.keeper = Keeper(server, store, folder / "logs", settings)
        try:
            ((payload, attachment),) = arm.states(physics, 1 / RATE)
            session.put(server.keys.joints, payload, attachment=attachment)
            wait_until(lambda: server.answering)
            yield Served(server, keeper, events, log)
        finally:
            server.close()
