"""What the benchmarks of the service share: processes, their network, a driver, a store."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.network.messages import Attachment
from limo_driver.network.streaming import JointStatePublisher, Keys
from limo_driver.trajectory import Trajectory
from limo_driver.types import JointState

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence
    from pathlib import Path

    import zenoh

    from estimators.service.store.store import ModelStore
    from limo_driver.recordings.recording import Recording

ARM = "bench"
RATE = 1000.0  # [Hz]
DELAY = 0.1  # [s], the default of the service
LIMO = [sys.executable, "-c", "from limo_driver.app.cli import main; main()"]
_GOLDEN = 5.0  # [s] of motion
_AHEAD = 8  # states that may be unanswered, where they are sent as fast as they are answered
_LOST = 0.1  # [s] after which an answer is given up
_SHORT = 2e-4  # [s]
_ENDING = 30.0  # [s] for a process to end by itself


def configurations(folder: Path, mode: str = "peer") -> tuple[Path, Path]:
    """Write configurations of this process, which listens, and of the others, which connect.

    In mode `router` this process also hands on what the others send to each other.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    alone = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    here, there = folder / "here.json5", folder / "there.json5"
    listen = {"mode": mode, "listen": {"endpoints": [endpoint]}, "scouting": alone}
    here.write_text(json.dumps(listen))
    role = "client" if mode == "router" else "peer"
    connect = {"mode": role, "connect": {"endpoints": [endpoint]}, "scouting": alone}
    there.write_text(json.dumps(connect))
    return here, there


@contextmanager
def running(
    *commands: Sequence[str], started: Sequence[subprocess.Popen[bytes]] = ()
) -> Generator[list[subprocess.Popen[bytes]]]:
    """Run processes, and those that are started, until the block ends."""
    processes = [*started, *(subprocess.Popen(command) for command in commands)]
    try:
        yield processes  # may be changed, where some are killed and begun anew
    finally:
        for process in processes:
            process.terminate()
        for process in processes:
            try:
                process.wait(_ENDING)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


class Motion:
    """Slow reversing motion of a model's joints.

    Args:
        model: Model folder.
    """

    def __init__(self, model: Path) -> None:
        from estimators.model_folder import load_model

        arm = load_model(model).simulation.model
        self.names = tuple(arm.joint_names)
        self._centre = 0.5 * (arm.limits.position_min + arm.limits.position_max) + 0.3

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return positions (T, n) [rad] at times (T,) [s]."""
        phase = np.arange(len(self.names))
        return self._centre + 0.05 * np.sin(2 * np.pi * 0.3 * time[:, None] + phase)

    def recording(self) -> Recording:
        """Return some seconds of it, without torque, for the golden motion of a version."""
        from limo_driver.recordings.recording import Recording

        t = np.arange(int(_GOLDEN * RATE)) / RATE
        q = self.at(t)
        return Recording.from_arrays(t, q, np.zeros_like(q), source="benchmark")


class Driver:
    """Publishes the motion at the rate, on a thread, until the block ends.

    Args:
        session: Open Zenoh session.
        motion: What the joints do.
        arm: Name of the arm in keys.
        between: Called half a cycle after each state, with its number.
        rate: Of the states [Hz].
        answers: If given, states are sent as fast as they are answered, not in real time.
    """

    def __init__(
        self,
        session: zenoh.Session,
        motion: Motion,
        arm: str = ARM,
        between: Callable[[int], None] | None = None,
        rate: float = RATE,
        answers: Answers | None = None,
    ) -> None:
        self._session, self._motion, self._arm, self._between = session, motion, arm, between
        self._rate, self._answers = rate, answers
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self.sent: list[float] = []  # of the performance counter [s], by number

    def __enter__(self) -> Driver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()

    def _drive(self) -> None:
        names = self._motion.names
        still = np.zeros(len(names))
        with JointStatePublisher(self._session, self._arm, names) as publisher:
            began = time.perf_counter()
            while not self._done.is_set():
                k = len(self.sent)
                t = k / self._rate
                state = JointState(t, self._motion.at(np.array([t]))[0], still, still, k)
                if self._answers is None:
                    sleep_until(began + t)
                else:
                    self._wait_for(self._answers)
                self.sent.append(time.perf_counter())
                publisher.publish(state)
                if self._between is not None:
                    sleep_until(began + t + 0.5 / self._rate)
                    self._between(k)

    def _wait_for(self, answers: Answers) -> None:
        """Wait until few states are unanswered; not for ever, since an answer may be lost."""
        ends = time.perf_counter() + _LOST
        while len(self.sent) - (answers.sequences[-1] if answers.sequences else 0) > _AHEAD:
            if time.perf_counter() > ends:
                return
            time.sleep(_SHORT)


class Answers:
    """When estimates came back, by the number of their state, in the order in which they came."""

    def __init__(self, session: zenoh.Session, key: str = Keys(ARM).estimate) -> None:
        from zenoh.handlers import Callback

        self.sequences: list[int] = []
        self.times: list[float] = []  # of the performance counter [s]
        self._subscriber = session.declare_subscriber(key, Callback(self.take, indirect=False))

    def take(self, sample: zenoh.Sample) -> None:
        """Note what came back."""
        self.times.append(time.perf_counter())
        attached = b"" if sample.attachment is None else sample.attachment.to_bytes()
        self.sequences.append(Attachment.decode(attached).sequence)

    def close(self) -> None:
        """Take no more."""
        self._subscriber.undeclare()

    def order(self) -> tuple[int, int]:
        """Return how many came twice, and how many after one that follows them."""
        numbers = np.array(self.sequences)
        twice = numbers.size - np.unique(numbers).size
        return twice, int((np.diff(numbers) < 0).sum())

    def round_trips(self, sent: Sequence[float], first: int = 0) -> np.ndarray:
        """Return how long each state from number `first` on took to be answered [ms], else NaN."""
        back = np.full(len(sent), np.nan)
        count = len(self.sequences)  # more may come meanwhile
        numbers, times = np.array(self.sequences[:count], int), np.array(self.times[:count])
        known = numbers < back.size
        back[numbers[known]] = times[known]
        return 1e3 * (back - np.array(sent))[first:]


def two_versions(root: Path, model: Path, motion: Motion) -> ModelStore:
    """Make a store of two versions of the same model."""
    from estimators.service.store.store import ModelStore

    store = ModelStore(root)
    for _ in range(2):
        store.add(model, golden=motion.recording(), delay=DELAY)
    store.promote(1, "the first")
    return store


def save_trajectory(path: Path, motion: Motion, robot: str, length: float) -> None:
    """Save motion of so many seconds that starts at rest in the middle of the benchmark's."""
    w, t = 2 * np.pi * 0.3, np.arange(0.0, length, 0.02)[:, None]
    q = motion.at(np.zeros(1)) + 0.0 * t
    Trajectory(
        time=t[:, 0],
        position=q + 0.05 * (1.0 - np.cos(w * t)),
        velocity=0.05 * w * np.sin(w * t) + 0.0 * q,
        acceleration=0.05 * w**2 * np.cos(w * t) + 0.0 * q,
        robot=robot,
    ).save(path)


def sleep_until(instant: float) -> None:
    """Sleep until a time of the performance counter; not at all if it has passed."""
    left = instant - time.perf_counter()
    if left > 0:
        time.sleep(left)


def wait_for(condition: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait for something that other processes bring about; end the benchmark without it."""
    ends = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= ends:
            sys.exit(f"no {what} within {seconds:g} s")
        time.sleep(0.002)


def serve(config: Path, *given: str) -> list[str]:
    """Return the command of the service of the arm; what is given wins."""
    arm = () if "--arm" in given else ("--arm", ARM)
    return [*LIMO, "serve", *arm, *given, "--zenoh-config", str(config)]


def describe_machine() -> str:
    """Return what else this machine does, since every figure depends on it."""
    loads = " ".join(f"{load:.1f}" for load in os.getloadavg())
    return f"{os.cpu_count()} CPUs, load {loads} (1, 5, 15 min)"
