"""Processes that run trials side by side, each on one core."""

from __future__ import annotations

import os
import sys
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimators.reproduction.rigid_body import physics_digest
from estimators.reproduction.trial import Trial, TrialStore
from limo_driver.errors import LimoError
from limo_driver.runtime.processes.worker_process import WorkerProcess, end_with_parent

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator
    from multiprocessing.connection import Connection

    from estimators.hybrid.training.fit import Epoch

_CPUS = Path("/sys/devices/system/cpu")


@dataclass(frozen=True)
class TrialPlace:
    """Arguments of a worker process; it reads everything else itself."""

    data: Path  # data folder
    simulation: Path  # sim.yaml of the identified rigid body
    trials: Path  # where finished trials are kept
    device: str  # of `TrainingSettings`

    def store(self) -> TrialStore:
        """Return where trials on this rigid body are kept.

        Raises:
            ConfigError: The sim.yaml cannot be read.
        """
        return TrialStore(self.trials, physics_digest(self.simulation))


@dataclass(frozen=True)
class Advanced:
    """A trial has gone through another epoch."""

    trial: Trial
    epoch: int


@dataclass(frozen=True)
class Finished:
    """A trial is done and kept."""

    trial: Trial
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A trial came to no end; nothing of it is kept."""

    trial: Trial
    reason: str


def run_trials(
    job: TrialPlace, trials: Iterable[Trial], processes: int
) -> Iterator[Advanced | Finished | Failed]:
    """Run trials in worker processes and tell how they get on, as it happens.

    When the caller stops listening, or is interrupted, the workers are killed at once; what they
    have finished is kept. A worker that dies, for want of memory for example, fails its trial only.

    Args:
        job: What all trials share.
        trials: In this order.
        processes: How many run side by side.
    """
    waiting = deque(trials)
    busy: dict[Connection, _Worker] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < processes:
                worker = _Worker(job)
                worker.start(waiting.popleft())
                busy[worker.connection] = worker
            for ready in connection.wait(list(busy)):
                worker = busy[ready]  # type: ignore[index]  # only connections were waited for
                message = worker.receive()
                yield message
                if isinstance(message, Advanced):
                    continue
                if waiting and worker.alive:
                    worker.start(waiting.popleft())
                else:
                    busy.pop(worker.connection).stop()
    finally:
        for worker in busy.values():
            worker.stop()


def physical_cores() -> int:
    """Return how many cores this process may use; two threads of one core count once."""
    try:
        usable = os.sched_getaffinity(0)
        siblings = {
            (_CPUS / f"cpu{cpu}" / "topology" / "thread_siblings_list").read_text()
            for cpu in usable
        }
        return len(siblings)
    except (OSError, AttributeError):  # no Linux
        return os.cpu_count() or 1


class _Worker(WorkerProcess[Trial]):
    """One process and the trial that it runs, on one thread."""

    def __init__(self, job: TrialPlace) -> None:
        with _one_thread():
            super().__init__(_work, job)

    @property
    def alive(self) -> bool:
        return not self.connection.closed

    def receive(self) -> Advanced | Finished | Failed:
        try:
            return self.connection.recv()
        except (EOFError, OSError):
            self.process.join()
            self.connection.close()
            return Failed(self.task, f"its process ended with status {self.process.exitcode}")


@contextmanager
def _one_thread() -> Generator[None]:
    """Let processes started inside compute on one thread each, which they read when they start."""
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["OMP_NUM_THREADS"]
        else:
            os.environ["OMP_NUM_THREADS"] = before


def _work(main: Connection[Any, Any], job: TrialPlace) -> None:
    """Run the trials that come through the pipe until its other end is closed."""
    end_with_parent()
    from estimators.reproduction.data import TableData
    from estimators.reproduction.trial_runner import TrialRunner
    from limo_driver.physics import Simulation

    runner = TrialRunner(TableData.load(job.data), Simulation.load(job.simulation), job.device)
    store = job.store()
    try:
        while True:
            main.send(_run(runner, store, main.recv(), main))
    except (EOFError, BrokenPipeError, ConnectionResetError):  # nobody listens any more
        sys.exit(0)


def _run(
    runner: Any,  # noqa: ANN401  # a TrialRunner, which imports what trains
    store: TrialStore,
    trial: Trial,
    main: Connection[Any, Any],
) -> Finished | Failed:
    def tell(epoch: Epoch) -> None:
        main.send(Advanced(trial, epoch.number))

    try:
        result = runner.run(trial, tell)
    except LimoError as error:
        return Failed(trial, str(error))
    store.save(result)
    return Finished(trial, result.seconds)
