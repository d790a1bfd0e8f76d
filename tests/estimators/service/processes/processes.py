"""A real service process, and a driver in the process of the tests, at 100 states a second."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from ports import free_port

from limo_driver.network.messages import Attachment, decode_torque_estimate
from limo_driver.network.streaming import JointStatePublisher, Keys
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointState

if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from pathlib import Path

    import zenoh

ARM, RATE = "arm", 100.0
NAMES = ("a", "b")
PATIENCE = 90.0  # [s]; everything is slow on a machine that tests share


class Network:
    """Files of Zenoh configurations: a router, through which its clients meet."""

    def __init__(self, folder: Path) -> None:
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        alone = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
        self.here, self.there = folder / "here.json5", folder / "there.json5"
        for file, role, mode in (
            (self.here, "listen", "router"),
            (self.there, "connect", "client"),
        ):
            values = {"mode": mode, role: {"endpoints": [endpoint]}, "scouting": alone}
            file.write_text(json.dumps(values))


class Answers:
    """Estimates as they come, and the states that were sent, by sequence number."""

    def __init__(self, session: zenoh.Session, arm: str = ARM) -> None:
        self.sequences: list[int] = []
        self.torque: list[np.ndarray] = []
        self.models: list[str] = []
        self.stamps: list[int] = []  # [ns]
        self.subscriber = session.declare_subscriber(Keys(arm).estimate, self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        estimate = decode_torque_estimate(sample.payload.to_bytes())
        assert sample.attachment is not None
        self.torque.append(estimate.torque)
        self.models.append(estimate.model)
        self.stamps.append(estimate.stamp_ns)
        self.sequences.append(Attachment.decode(sample.attachment.to_bytes()).sequence)

    def later(self, count: int = 20) -> None:
        """Wait until so many more came."""
        begin = len(self.sequences)
        wait_for(lambda: len(self.sequences) >= begin + count)


def slow_motion(folder: Path, seconds: float, urdf: Path) -> Path:
    """Write a slow motion of two links; return its file, beside the arm that it is of."""
    t = np.arange(0.0, seconds, 0.05)[:, None]
    (folder / "two_links.urdf").write_text(urdf.read_text())
    path = folder / "motion.traj.parquet"
    Trajectory(
        time=t[:, 0],
        position=np.array([0.4, -0.8]) + 0.1 * (1.0 - np.cos(t)),
        velocity=0.1 * np.sin(t) * np.ones(2),
        acceleration=0.1 * np.cos(t) * np.ones(2),
        robot="two_links",
    ).save(path)
    return path


def wait_for(condition: Callable[[], bool], seconds: float = PATIENCE) -> None:
    """Wait for something that other processes bring about."""
    ends = time.monotonic() + seconds
    while not condition() and time.monotonic() < ends:
        time.sleep(0.01)
    assert condition()


@contextmanager
def driven(session: zenoh.Session, arm: str = ARM) -> Generator[None]:
    """Publish slow reversing motion until the block ends."""
    done = threading.Event()

    def drive() -> None:
        with JointStatePublisher(session, arm, NAMES) as publisher:
            began, k = time.monotonic(), 0
            while not done.wait(max(0.0, began + k / RATE - time.monotonic())):
                publisher.publish(state_at(k))
                k += 1

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


def state_at(k: int) -> JointState:
    """Return the state of a sequence number."""
    t = k / RATE
    position = np.array([0.4, -0.8]) + 0.1 * np.sin(2.0 * t + np.arange(2))
    return JointState(t, position, np.zeros(2), np.zeros(2), k)


def told(file: Path, kind: str) -> list[dict[str, object]]:
    """Return what a service told of a kind; the last line may be half written."""
    lines = file.read_text().split("\n")[:-1]
    return [line for line in map(json.loads, lines) if line.get("event") == kind]


def limo(*arguments: object) -> list[str]:
    """Return the command line of a limo command."""
    call = "from limo_driver.app.cli import main; main()"
    return [sys.executable, "-c", call, *map(str, arguments)]


@contextmanager
def served(
    network: Network, *arguments: object, **options: Any
) -> Generator[subprocess.Popen[Any]]:
    """Run `limo serve` in a process of its own, and end it however it stands."""
    command = limo("serve", *arguments, "--zenoh-config", network.there)
    with subprocess.Popen(command, **options) as process:
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(PATIENCE)
            finally:
                process.kill()
