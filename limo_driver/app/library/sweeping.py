"""Train networks with many settings, and keep each; the best is judged on motion not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Final, Literal

from limo_driver.app.library.executors import attempted, check_place, executor_of, run_all
from limo_driver.app.library.inputs import expected, recordings_of, simulation_of
from limo_driver.errors import ConfigError
from limo_driver.recordings.bandwidth import bandwidth_for
from limo_driver.runtime.outputs import only_writer, require_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from estimators.studies import Sweep, SweepSpace, SweepTrial
    from estimators.studies.sweep_trial import SweepOutcome, SweepStore
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

_BASE: Final = 0.7e9  # [bytes] of a process that trains
_BY_SAMPLE: Final = 20e3  # [bytes] more for each sample that is trained on


@dataclass(frozen=True)
class SweepJob:
    """What all trials share, data included: nodes need no folder of this machine."""

    simulation: Simulation
    recordings: tuple[Recording, ...]
    tests: tuple[Recording, ...]

    def do(self, trial: SweepTrial) -> SweepOutcome | str:
        """Train and judge one trial.

        Args:
            trial: Its settings.
        """
        from estimators.studies.sweep_trial import SweepOutcome

        start = perf_counter()
        return attempted(
            lambda: self._trained(trial, start),
            lambda line: SweepOutcome(perf_counter() - start, line),
        )

    def memory_of(self, trial: SweepTrial) -> float:  # noqa: ARG002  # the same data for all
        """Return how much memory a trial takes at most [bytes]."""
        return _BASE + _BY_SAMPLE * sum(map(len, self.recordings))

    def _trained(self, trial: SweepTrial, start: float) -> SweepOutcome:
        import numpy as np

        from estimators.hybrid import HybridModel
        from estimators.hybrid.model import train
        from estimators.studies.sweep_trial import SweepOutcome, error_left, judged
        from limo_driver.app.library.learning import evaluate

        settings = trial.settings
        model = HybridModel(self.simulation, settings)
        model.fitted_ = train(self.simulation, self.recordings, settings)
        left, rmse = judged(model, self.recordings, settings)
        found = [evaluate(model, recording) for recording in self.tests]
        tests = [error_left(own.hybrid.rmse, own.rigid_body.rmse) for own in found]
        test = float(np.mean(tests)) if tests else float("nan")
        return SweepOutcome(perf_counter() - start, "", left, test, rmse, model.fitted_)


def sweep(
    simulation: Simulation | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
    space: SweepSpace | Path | str,
    out: Path | str,
    *,
    tests: Recording | Path | str | Iterable[Recording | Path | str] = (),
    workers: int | None = None,
    on: Literal["processes", "ray"] = "processes",
    progress: Callable[[SweepTrial | None, int, int], None] | None = None,
) -> Sweep:
    """Train a network with every setting of a space, side by side, and rank them.

    What is trained is kept in `out` at once: after any interruption, the same call goes on where it
    was, and a larger space adds to what is there. Every worker is a process, and in a program that
    is a file, the call has to stand behind `if __name__ == "__main__":`.

    Args:
        simulation: Normally an identified one, or its file.
        recordings: Of its robot: one or several, or their files.
        space: Which settings are tried, or its space.yaml.
        out: Folder for results.parquet, sweep.html, every model, and the best of them.
        tests: Recordings of other motion on which each network is evaluated; they choose nothing.
        workers: How many run at a time at most; one for each core if not given.
        on: "processes" of this machine, or a cluster of "ray". Both give the same networks.
        progress: Told each trial as it ends, how many have, and of how many; first of all without
            a trial, how many had ended before.

    Returns:
        Every trial, ranked settings, and the best trial, whose model lies in its `folder`.

    Raises:
        MissingPackageError: PyTorch is not installed.
        ConfigError: The space cannot be read or has a combination that cannot be, no trial could be
            trained, the folder cannot be written to, or nodes of the cluster have other versions.
        RecordingError: A recording cannot be used.

    Example:
        >>> limo.sweep("sim.yaml", "run.parquet", "space.yaml", "sweep/").best.settings
    """
    from estimators.base import check_recordings
    from estimators.studies import Sweep
    from estimators.studies.sweep import save_sweep
    from estimators.studies.sweep_trial import SweepStore

    known, folder = simulation_of(simulation), Path(out)
    check_place(workers, on)
    tried = _space_of(space)
    measured, others = recordings_of(recordings), recordings_of(tests)
    check_recordings(measured, known.model)
    for other in others:
        other.check_robot(known.model)
    job = SweepJob(known, measured, others)
    trials = _trials(tried, job, bandwidth_for(measured))
    require_folder(folder, "the sweep")
    with only_writer(folder):
        store = SweepStore.at(folder, known)
        ended = _ended(
            job, trials, store, (workers, on), progress or (lambda _trial, _done, _all: None)
        )
        found = Sweep(ended, tried.varied)
        save_sweep(found, folder)
    if not found.ranked:
        raise ConfigError(f"no trial could be trained: {found.failed[0].error}", path=folder)
    return found


def _ended(
    job: SweepJob,
    trials: Sequence[SweepTrial],
    store: SweepStore,
    where: tuple[int | None, str],
    progress: Callable[[SweepTrial | None, int, int], None],
) -> tuple[SweepTrial, ...]:
    """Train what is not finished yet; return all trials with how they ended."""
    from estimators.hybrid.training.settings import require_torch

    ended = {t.key: done for t in trials if (done := store.finished(t)) is not None}
    left = [trial for trial in trials if trial.key not in ended]
    if left:
        require_torch()
    progress(None, len(ended), len(trials))
    for trial, outcome in run_all(executor_of(job, *where), left) if left else ():
        if isinstance(outcome, str):
            ended[trial.key] = replace(trial, error=f"{outcome}, twice")
        else:
            store.keep(trial, outcome)
            ended[trial.key] = store.finished(trial) or replace(trial, error="cannot be read")
        progress(ended[trial.key], len(ended), len(trials))
    return tuple(ended[trial.key] for trial in trials)


def _space_of(space: SweepSpace | Path | str) -> SweepSpace:
    from estimators.studies import SweepSpace

    if isinstance(space, (Path, str)):
        return SweepSpace.load(Path(space))
    return expected("space", space, SweepSpace, "a SweepSpace or the path of a space.yaml")


def _trials(space: SweepSpace, job: SweepJob, bandwidth: float) -> tuple[SweepTrial, ...]:
    """Return the trials of a space, each once, with keys that change with data and settings."""
    from estimators.studies import SweepTrial
    from estimators.studies.fleet import digest_of
    from estimators.studies.sweep_trial import key_of_trial

    digest = sha256(digest_of(job.simulation).encode())
    for recording in (*job.recordings, *job.tests):
        for values in (recording.time, recording.position, recording.torque):
            digest.update(values.tobytes())
        digest.update(b"|")
    digest.update(str(len(job.tests)).encode())
    data = digest.hexdigest()
    found = [SweepTrial(item, key_of_trial(item, data)) for item in space.settings(bandwidth)]
    return tuple({trial.key: trial for trial in found}.values())
