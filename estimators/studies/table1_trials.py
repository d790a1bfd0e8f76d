"""Train and score the trials of the table."""

from __future__ import annotations

import os
import shutil
import time
from dataclasses import dataclass, replace
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, inputs_and_torque, prepare
from estimators.hybrid.training.fit import fit_prepared
from estimators.studies.table1_data import PARTS
from estimators.studies.table1_results import SCAFFOLDS, Trial, TrialResult

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from estimators.hybrid.training.data import TrainingData
    from estimators.hybrid.training.fit import Epoch
    from estimators.hybrid.training.settings import TrainingSettings
    from estimators.neural import Network
    from estimators.studies.table1_data import TableData
    from limo_driver.physics import Simulation
    from limo_driver.types import BoolArray, FloatArray

_CPUS = Path("/sys/devices/system/cpu")
_PACKAGES: Final = ("limo", "numpy", "torch", "pin")


@dataclass(frozen=True)
class Failed:
    """A trial came to no end; nothing of it is kept."""

    trial: Trial
    reason: str


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


@dataclass(frozen=True)
class ScoringMotion:
    """Motion to be scored: the normalised inputs and targets of a network, and what counts."""

    inputs: NDArray[np.floating]  # (T, d)
    targets: NDArray[np.floating]  # (T, n)
    scored: BoolArray  # (T,)
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
        unfinished: Folder in which trials that a kill may end are kept epoch by epoch.
    """

    data: TableData
    simulation: Simulation
    device: str = "auto"
    unfinished: Path | None = None

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
            kept = self.unfinished and self.unfinished / trial.file_name
            fitted = fit_prepared(prepared, settings, on_epoch, kept)
            if kept is not None:
                shutil.rmtree(kept, ignore_errors=True)
            network = fitted.network
            epochs, device = len(fitted.record["epochs"]), str(fitted.record["device"])
        # The MSE of each part and joint [(N m)²]
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
        return TrialResult(
            trial,
            {
                part: tuple((variance * squares.mean(axis=0)).tolist())
                for part, squares in zip(PARTS, by_part, strict=True)
            },
            epochs,
            time.perf_counter() - began,
            device,
            {name: version(name) for name in _PACKAGES},
        )

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
