"""Simulate: one run of a robot, a data set of many, or what recorded commands make of an arm.

Many runs of a simulated arm, on all cores.

Threads, not processes: the compiled loop and MuJoCo in it leave the interpreter to others, and
nothing has to be imported, compiled or copied again, which took longer than the runs themselves.
"""

from __future__ import annotations

import os
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

from limo_driver.app.library.executors import attempted, check_place, executor_of, run_all
from limo_driver.app.library.inputs import recording_of, simulation_of
from limo_driver.app.library.reading import read_commanded
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation
from limo_driver.recordings.commanded import Commanded
from limo_driver.recordings.files.recorder import header_of
from limo_driver.recordings.recording import Recording
from limo_driver.robot.playback import trajectory_of
from limo_driver.runtime.outputs import only_writer, require_folder, whole
from limo_driver.runtime.parameters import seed_of
from limo_driver.trajectory import Planned, Trajectory
from limo_driver.types import FloatArray

# [s] that a thread may keep the interpreter from another that comes out of the compiled loop after
# some milliseconds: by the usual 5 ms two workers did 1.5 times the work of one, by this 1.7.
_SWITCH_INTERVAL: Final = 5e-4
_BASE: Final = 0.4e9  # [bytes] of a process that simulates
_BY_SIZE: Final = 30.0  # [bytes] more for each of a trajectory's file
_ENDINGS: Final = (".parquet", ".pq", ".traj")
_KEY: Final = "dataset"  # in the provenance of a recording: what it was made of


def simulate(
    simulation: Simulation | Path | str,
    trajectories: Sequence[Trajectory | Planned | Path | str],
    seeds: Sequence[int] = (0,),
    *,
    workers: int | None = None,
) -> list[Recording]:
    """Move a simulated arm along every trajectory with every seed, side by side.

    Each run is what `run("mujoco", ...)` gives with that seed, whatever runs beside it. Workers are
    threads: effects that are written in Python alone run one at a time.

    Args:
        simulation: Physics of the arm, or its file.
        trajectories: Motions, or their files.
        seeds: Of the sensors' noise.
        workers: How many run at a time; one for each core if not given.

    Returns:
        Recordings, all seeds of the first trajectory first.

    Raises:
        ConfigError: A trajectory is of another robot, a seed is no whole number, or there are no
            workers.
        LimoError: As for `run`.

    Example:
        >>> limo.simulate("sim.yaml", ["limo.traj.parquet"], seeds=[1, 2], workers=1)
    """
    arm = simulation_of(simulation)
    motions, seeds = [trajectory_of(item) for item in trajectories], [seed_of(s) for s in seeds]
    wanted = workers if workers is not None else len(os.sched_getaffinity(0))
    if wanted < 1:
        raise ConfigError(f"workers is {wanted}, expected at least 1")
    for motion in motions:
        motion.check_robot(arm.model.n, arm.model.name)
    jobs = [(arm, motion, seed) for motion in motions for seed in seeds]
    wanted = min(wanted, len(jobs))
    if wanted <= 1:
        return [_run(*job) for job in jobs]
    ended = threading.Event()
    pool = ThreadPoolExecutor(wanted, thread_name_prefix="limo-simulate")
    interval = sys.getswitchinterval()
    sys.setswitchinterval(min(interval, _SWITCH_INTERVAL))
    try:
        return list(pool.map(partial(_run, ended=ended), *zip(*jobs, strict=True)))
    finally:  # after an error, or Ctrl-C, what still runs is not wanted any more
        ended.set()
        pool.shutdown(cancel_futures=True)
        sys.setswitchinterval(interval)


def _run(
    simulation: Simulation, motion: Trajectory, seed: int, *, ended: threading.Event | None = None
) -> Recording:
    from limo_driver.app.library.moving import run

    def go_on(_done: int, _all: int) -> None:
        if ended is not None and ended.is_set():
            raise CancelledError

    return run("mujoco", motion, simulation=simulation, seed=seed, progress=go_on)


@dataclass(frozen=True)
class DatasetRun:
    """One trajectory with one seed: a recording of a data set."""

    name: str  # of its file
    trajectory: Path | str  # file, or URL of an object
    seed: int
    key: str  # changes with trajectory, simulation, seed, rate and version of limo
    bytes: int = 0  # of the trajectory
    error: str = ""  # one line, where there is no recording


@dataclass(frozen=True)
class SimulatedDataset:
    """The recordings of a data set, in the order of trajectories and seeds."""

    folder: Path
    runs: tuple[DatasetRun, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """What was recorded."""
        return tuple(self.folder / run.name for run in self.runs if not run.error)

    @property
    def failed(self) -> tuple[DatasetRun, ...]:
        """What could not be simulated, and why."""
        return tuple(run for run in self.runs if run.error)

    def __str__(self) -> str:
        trajectories = len({run.trajectory for run in self.runs})
        seeds = len({run.seed for run in self.runs})
        return (
            f"{len(self.files)} of {len(self.runs)} recordings in {self.folder}: "
            f"{trajectories} trajectories, {seeds} seeds"
        )


@dataclass(frozen=True)
class SimulationJob:
    """What all recordings of a data set share."""

    simulation: Simulation
    rate: float | None  # [Hz]; every control cycle, if none

    def do(self, run: DatasetRun) -> bytes | ConfigError | str:
        """Simulate one trajectory with one seed, on one thread.

        Args:
            run: Whose trajectory is read.

        Returns:
            The file of its recording; the error of what cannot be simulated; or, if it was the
            machine or limo itself that failed, why.
        """
        return attempted(lambda: self._recorded(run), ConfigError)

    def memory_of(self, run: DatasetRun) -> float:
        """Return how much memory it takes at most [bytes], by the trajectory's size."""
        return _BASE + _BY_SIZE * run.bytes

    def _recorded(self, run: DatasetRun) -> bytes:
        from limo_driver.app.library.fleets import at_hand
        from limo_driver.app.library.moving import play

        with at_hand(run.trajectory) as trajectory, TemporaryDirectory() as folder:
            file = Path(folder) / run.name
            play(
                "mujoco", trajectory, file, simulation=self.simulation, seed=run.seed,
                rate=self.rate, about={_KEY: run.key},
            )  # fmt: skip
            return file.read_bytes()


def simulate_dataset(
    simulation: Simulation | Path | str,
    trajectories: Path | str | Iterable[Path | str],
    out: Path | str,
    seeds: Sequence[int] = (0,),
    *,
    rate: float | None = None,
    workers: int | None = None,
    on: Literal["processes", "ray"] = "processes",
    progress: Callable[[DatasetRun | None, int, int], None] | None = None,
) -> SimulatedDataset:
    """Simulate every trajectory with every seed, side by side, into a folder of recordings.

    What is finished is kept at once: after any interruption, the same call goes on where it was. A
    recording is simulated anew where its trajectory, the simulation, the rate or the version of
    limo are others. Every worker is a process, and in a program that is a file, the call has to
    stand behind `if __name__ == "__main__":`.

    Args:
        simulation: Physics of the arm, or its file.
        trajectories: Files, or patterns such as `plans/*.traj.parquet`; URLs as for recordings.
        out: Folder for the recordings, `<trajectory>_seed<k>.parquet`.
        seeds: Of the sensors' noise.
        rate: Record at this rate [Hz], a part of the control rate; every cycle if not given.
        workers: How many run at a time at most; one for each core if not given.
        on: "processes" of this machine, or a cluster of "ray"; both give the same recordings.
        progress: Told each run as it is finished, how many are, and of how many; first of all
            without a run, how many were finished before.

    Returns:
        The recordings, and what could not be simulated.

    Raises:
        ConfigError: A pattern matches no file, two trajectories have one name, a seed is no whole
            number, the folder cannot be written to, nothing at all could be simulated, or nodes of
            the cluster have other versions of limo.

    Example:
        >>> limo.simulate_dataset("sim.yaml", "plans/*.traj.parquet", "data/", seeds=range(10))
    """
    from limo_driver.app.library.fleets import matched

    known, folder = simulation_of(simulation), Path(out)
    check_place(workers, on)
    found = matched(trajectories, "trajectories")
    runs = _runs(found, [seed_of(seed) for seed in seeds], known, rate)
    inputs = [place for place in found if isinstance(place, Path)]
    require_folder(folder, "the data set", (run.name for run in runs), inputs)
    with only_writer(folder):
        ended = {run.name: run for run in runs if run.error or _is_made(folder / run.name, run.key)}
        left = [run for run in runs if run.name not in ended]
        if progress is not None:
            progress(None, len(ended), len(runs))
        executor = executor_of(SimulationJob(known, rate), workers, on) if left else None
        for run, outcome in run_all(executor, left) if executor else ():
            if isinstance(outcome, bytes):
                with whole(folder / run.name) as draft:
                    draft.write_bytes(outcome)
                ended[run.name] = run
            else:
                again = f"{outcome}, twice" if isinstance(outcome, str) else str(outcome)
                ended[run.name] = replace(run, error=again.removeprefix(f"{run.trajectory}: "))
            if progress is not None:
                progress(ended[run.name], len(ended), len(runs))
    dataset = SimulatedDataset(folder, tuple(ended[run.name] for run in runs))
    if not dataset.files:
        first = dataset.failed[0]
        raise ConfigError(
            f"none of {len(runs)} runs could be simulated; {first.trajectory}: {first.error}"
        )
    return dataset


def _runs(
    trajectories: Sequence[Path | str], seeds: Sequence[int], simulation: Simulation, rate: object
) -> list[DatasetRun]:
    """Return all runs; those of a trajectory that cannot be read have an error."""
    from estimators.studies.fleet import digest_of
    from limo_driver.app.library.fleets import key_and_size

    if not seeds:
        raise ConfigError("no seeds given, expected at least one")
    stems = [_stem(place) for place in trajectories]
    if twice := [stem for stem, count in Counter(stems).items() if count > 1]:
        same = ", ".join(str(p) for p, s in zip(trajectories, stems, strict=True) if s == twice[0])
        raise ConfigError(f"trajectories of one name would be one recording: {same}")
    digest = digest_of(simulation, rate)
    runs: list[DatasetRun] = []
    for place, stem in zip(trajectories, stems, strict=True):
        known, size, error = "", 0, ""
        try:
            known, size = key_and_size(place, digest)
        except OSError as failure:
            error = f"cannot be read: {failure.strerror or failure}"
        runs += [
            DatasetRun(
                f"{stem}_seed{seed}.parquet",
                place,
                seed,
                sha256(f"{known} {seed}".encode()).hexdigest(),
                size,
                error,
            )
            for seed in dict.fromkeys(seeds)
        ]
    return runs


def _stem(place: Path | str) -> str:
    name = Path(str(place).split("::", maxsplit=1)[0]).name
    for ending in _ENDINGS:
        name = name.removesuffix(ending)
    return name


def _is_made(file: Path, key: str) -> bool:
    """Say whether a recording is there that was made of the same."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        about = header_of(pq.read_schema(file)).get("provenance")
    except (OSError, ValueError, pa.ArrowException):  # RecordingError is a ValueError
        return False
    return isinstance(about, dict) and about.get(_KEY) == key


@dataclass(frozen=True)
class ForwardMotion:
    """What a simulated arm made of commands."""

    told: Commanded
    position: FloatArray  # (T, n) [rad], as the encoders would read it
    warnings: tuple[str, ...]  # what makes one doubt the commands


def predict_forward(
    simulation: Simulation | Path | str, recording: Recording | Commanded | Path | str
) -> FloatArray:
    """Simulate a recorded motion forward from its commands alone, without looking at the rest.

    Args:
        simulation: With drives; or its file.
        recording: T samples of n joints with commands, or its file, of which all rows with a time
            and commands count. The simulated arm starts at rest at the first recorded position;
            the last command before a gap stays in force.

    Returns:
        Positions (T, n) [rad].

    Raises:
        ConfigError: A joint has no drive, or an effect cannot be run forward.
        RecordingError: The recording has no commands or no first position, is of another robot, or
            its commands are no set-points in rad: held against the recorded motion where there is
            one.

    Example:
        >>> limo.predict_forward("servos.yaml", "commanded.parquet")
    """
    return simulate_forward(simulation_of(simulation), recording).position


def simulate_forward(
    simulation: Simulation, recording: Recording | Commanded | Path | str
) -> ForwardMotion:
    """Do as `predict_forward` does, and return the rows as well, and what is odd about them."""
    from estimators.diagnosis.from_motion import commanded_run
    from estimators.diagnosis.from_motion.checks.recorded import check_forward

    if isinstance(recording, (Path, str)):
        told = read_commanded(recording, simulation.model)
    elif isinstance(recording, Commanded):
        told = recording
    else:
        told = Commanded.of(recording_of(recording))
    odd = check_forward(simulation, told)
    return ForwardMotion(told, commanded_run(simulation, told), odd)
