"""Processes that run trials side by side, each on one core."""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, inputs_and_torque, prepare
from estimators.hybrid.training.fit import fit_prepared
from estimators.reproduction.data import PARTS, physics_digest
from estimators.reproduction.results import SCAFFOLDS, Trial, TrialResult, TrialStore
from limo_driver.errors import LimoError
from limo_driver.runtime.processes import WorkerProcess, end_with_parent

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from multiprocessing.connection import Connection

    from numpy.typing import NDArray

    from estimators.hybrid.training.data import TrainingData
    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.neural import Network
    from estimators.reproduction.data import TableData
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

_CPUS = Path("/sys/devices/system/cpu")
_PACKAGES: Final = ("limo", "numpy", "torch", "pin")


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


@dataclass(frozen=True)
class ScoringMotion:
    """Motion to be scored: the normalised inputs and targets of a network, and what counts."""

    inputs: NDArray[np.floating]  # (T, d)
    targets: NDArray[np.floating]  # (T, n)
    scored: NDArray[np.bool_]  # (T,)
    stretches: tuple[slice, ...]  # without a gap
    nothing: FloatArray  # (n,), the normalised target of zero torque

    def squared_errors(self, network: Network | None, length: int) -> FloatArray:
        """Predict in sub-sequences of `length` samples, each from zero memory.

        Each stretch is cut from its first scored sample on; what is left at its end makes a shorter
        sub-sequence, so that every scored sample is answered.

        Args:
            network: What predicts the targets; without one, no torque is predicted.
            length: Samples T of a sub-sequence.

        Returns:
            Squared errors of the normalised targets, (T, n); NaN where not scored.
        """
        errors = np.full(self.targets.shape, np.nan)
        for rows in chain.from_iterable(
            self._pieces(stretch, length) for stretch in self.stretches
        ):
            predicted = self.nothing
            if network is not None:
                x = self.inputs[rows].astype(np.float64)
                predicted, _ = network.advance(network.init(1), x)
            errors[rows] = (self.targets[rows] - predicted) ** 2
        errors[~self.scored] = np.nan
        return errors

    def _pieces(self, stretch: slice, length: int) -> Iterator[slice]:
        inside = np.flatnonzero(self.scored[stretch]) + stretch.start
        if inside.size:
            for start in range(int(inside[0]), int(inside[-1]) + 1, length):
                yield slice(start, min(start + length, int(inside[-1]) + 1))


@dataclass(frozen=True)
class TrialRunner:
    """Trains and scores trials, which share data and rigid body.

    Args:
        data: The recordings.
        simulation: The identified rigid body, gives tau_RBD.
        device: Where networks are trained, of `TrainingSettings`.
    """

    data: TableData
    simulation: Simulation
    device: str = "auto"

    def run(self, trial: Trial, on_epoch: Callable[[Epoch], None] = lambda _: None) -> TrialResult:
        """Train and score one trial.

        Raises:
            RecordingError: The recordings are too short for the trial.
            DivergedError: The loss is no longer finite.
        """
        began = time.perf_counter()
        settings = replace(trial.settings, device=self.device)
        recordings = self.data.scaffolds() if trial.split == SCAFFOLDS else (self.data.limo,)
        prepared = prepare(
            self.simulation, recordings, settings, np.random.default_rng(settings.seed)
        )
        network, epochs, device = None, 0, "cpu"
        if trial.row.model is not None:
            fitted = fit_prepared(prepared, settings, on_epoch)
            network = fitted.network
            epochs, device = len(fitted.record["epochs"]), str(fitted.record["device"])
        return TrialResult(
            trial,
            self._mse(trial, settings, prepared, network),
            epochs,
            time.perf_counter() - began,
            device,
            {name: version(name) for name in _PACKAGES},
        )

    def _mse(
        self,
        trial: Trial,
        settings: TrainingSettings,
        prepared: TrainingData,
        network: Network | None,
    ) -> dict[str, tuple[float, ...]]:
        """Return the MSE of each part and joint [(N m)²]."""
        length = trial.row.sequence_length
        nothing = prepared.output_scaling.normalise(np.zeros(prepared.targets.shape[1]))
        seen = ScoringMotion(
            prepared.inputs,
            prepared.targets,
            prepared.use != LEFT_OUT,
            prepared.stretches,
            nothing,
        )
        errors = seen.squared_errors(network, length)
        unseen = self._validation(settings, prepared)
        by_part = (
            errors[prepared.use == TRAINING],
            errors[prepared.use == HELD_OUT],
            unseen.squared_errors(network, length)[unseen.scored],
        )
        variance = prepared.output_scaling.std**2
        return {
            part: tuple((variance * squares.mean(axis=0)).tolist())
            for part, squares in zip(PARTS, by_part, strict=True)
        }

    def _validation(self, settings: TrainingSettings, prepared: TrainingData) -> ScoringMotion:
        """Return the validation motion as the training motion is: filtered and normalised."""
        recording = self.data.validation
        features = settings.features_for(self.simulation.model.n)
        x, torque = inputs_and_torque(self.simulation, recording, features, settings)
        target = recording.filtered_torque(settings.bandwidth) - torque
        return ScoringMotion(
            prepared.input_scaling.normalise(x),
            prepared.output_scaling.normalise(target),
            ~recording.edges(settings.bandwidth),
            recording.segments,
            prepared.output_scaling.normalise(np.zeros(target.shape[1])),
        )
