"""Six recordings, and what the commands make of them: the values that are frozen.

Only commands are used, as a user would, so that the values outlive any move of the code behind
them. Each stage starts from stored inputs, not from the stage before it: where `identify` changes,
the others do not fail with it. All stages run inside one folder and name its files without a path,
so no path gets into a value.
"""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pinocchio
import pyarrow.parquet as pq
import yaml
from frozen_values import FITS, SUMS, TRAINED, summary
from numba.core.event import RecordingListener, install_listener
from safetensors.numpy import load_file
from threadpoolctl import threadpool_limits

from limo_driver.cli import main

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

DATA = Path(__file__).parent / "data"
FROZEN = Path(__file__).parent / "frozen"
REAL = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
EXAMPLE_ROBOTS = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
DELAY = 0.1  # [s], of the prediction from the past alone

# what files and packages are at the time, which is not what was computed
LEFT_OUT = ("sha256", "packages")

_VALUES = "values.json"
TERMINAL = {"COLUMNS": "200", "NO_COLOR": "1"}


@dataclass(frozen=True)
class Stretch:
    """Part of a recording.

    Args:
        file: Of the recording (Parquet).
        start: Of the part [s].
        stop: Of the part [s].
    """

    file: Path
    start: float
    stop: float

    def write(self, path: Path) -> None:
        """Write time, positions, velocities and torques of this part."""
        table = pq.read_table(self.file)
        kept = [c for c in table.column_names if c.split("_")[0] in _COLUMNS]
        time = table["time"].to_numpy()
        inside = (time >= self.start) & (time < self.stop)
        pq.write_table(table.select(kept).filter(inside), path)


_COLUMNS = ("time", "position", "velocity", "torque")


@dataclass(frozen=True)
class Case:
    """An arm, one stretch to identify it from, and one for all that comes after.

    Args:
        robot: Built-in name, or the URDF.
        first: What `identify` gets.
        second: What `train`, `diagnose` and `predict` get.
        network: Options of `limo train` that make a small network.
        believed: The simulation they start from; None: the one that was identified and frozen.
        bandwidth: Of the zero-phase filter [Hz].
        identify: More options of `limo identify`.
    """

    robot: str | Path
    first: Stretch
    second: Stretch
    network: tuple[object, ...]
    believed: Path | None = None
    bandwidth: float = 8.0
    identify: tuple[object, ...] = ()

    @property
    def absent(self) -> tuple[Path, ...]:
        """Return the files that this needs and that are not there."""
        named = [self.first.file, self.second.file, self.believed, self.robot]
        return tuple(f for f in named if isinstance(f, Path) and not f.is_file())

    def prepare(self, folder: Path, identified: Mapping[str, Any] | None) -> None:
        """Put recordings, robot and simulation into the folder that the stages run in."""
        self.first.write(folder / "first.parquet")
        self.second.write(folder / "second.parquet")
        if isinstance(self.robot, Path):
            shutil.copy(self.robot, folder)
        if self.believed is not None:
            shutil.copy(self.believed, folder / "believed.yaml")
        elif identified is not None:
            text = yaml.safe_dump(dict(identified), sort_keys=False)
            (folder / "believed.yaml").write_text(text, encoding="utf-8")

    @property
    def robot_name(self) -> str:
        """Return what the commands call the robot, inside the folder."""
        return self.robot.name if isinstance(self.robot, Path) else self.robot


def _simulated(name: str, robot: str | Path, network: tuple[object, ...]) -> Case:
    run = Stretch(DATA / f"{name}.parquet", 0.0, 60.0)  # all of it
    believed = DATA / f"{name}_believed.yaml"
    return Case(robot, run, run, network, believed, bandwidth=10.0)


_UR10E, _LWR4, _PANDA = REAL / "ur10e", REAL / "kuka_lwr4", REAL / "panda"
_PANDA_RUN = _PANDA / "exciting_trajectory.parquet"

CASES = {
    "iiwa14_explored": _simulated(
        "iiwa14_explored", "iiwa14",
        ("--model", "mlp7", "--epochs", 2, "--rate", 50),
    ),
    "iiwa14_excited": _simulated(
        "iiwa14_excited", "iiwa14",
        ("--model", "lstm-fcl", "--epochs", 2, "--rate", 50, "--hidden", 8),
    ),
    "two_links": _simulated(
        "two_links", DATA / "two_links.urdf",
        ("--model", "transformer", "--epochs", 1, "--rate", 50, "--hidden", 8),
    ),
    "ur10e": Case(
        _UR10E / "ur10e.urdf",
        Stretch(_UR10E / "unloaded_14harm.parquet", 0.0, 40.0),
        Stretch(_UR10E / "loaded_14harm.parquet", 0.0, 40.0),
        ("--model", "mlp7", "--features", "drive", "--epochs", 2),
        identify=("--moving-only",),
    ),
    "lwr4": Case(
        _LWR4 / "kuka_lwr4.urdf",
        Stretch(_LWR4 / "measurements_2.parquet", 0.0, 25.0),
        Stretch(_LWR4 / "measurements_1.parquet", 0.0, 25.0),
        ("--model", "mlp7", "--features", "own-joint", "--epochs", 1, "--rate", 50),
    ),
    "panda": Case(
        EXAMPLE_ROBOTS / "panda_description/urdf/panda.urdf",
        Stretch(_PANDA_RUN, 0.0, 14.0),
        Stretch(_PANDA_RUN, 5.0, 21.0),
        ("--model", "lstm-2", "--epochs", 1, "--rate", 50, "--hidden", 8),
    ),
}  # fmt: skip


class CommandFailedError(RuntimeError):
    """A command ended otherwise than with exit status 0."""

    def __init__(self, arguments: tuple[str, ...], status: object, said: str) -> None:
        super().__init__(f"`{' '.join(arguments)}` ended with {status}, expected 0: {said}")


def limo(*arguments: object) -> str:
    """Run a command in this process, and return what it printed."""
    given = ("limo", *map(str, arguments))
    printed, said = io.StringIO(), io.StringIO()
    status: object = None
    with (
        patch.object(sys, "argv", list(given)),
        patch.dict(os.environ, TERMINAL),
        redirect_stdout(printed),
        redirect_stderr(said),
    ):
        try:
            main()
        except SystemExit as ended:
            status = ended.code
    if status:
        raise CommandFailedError(given, status, said.getvalue().strip())
    return printed.getvalue()


def _identify(case: Case) -> dict[str, Any]:
    options = ("--robot", case.robot_name, "--bandwidth", case.bandwidth, *case.identify)
    printed = limo("identify", "first.parquet", *options, "--out", "identified.yaml", "--json")
    return {"printed": json.loads(printed), "sim": yaml_of("identified.yaml")}


def _diagnose(case: Case) -> dict[str, Any]:
    options = ("--sim", "believed.yaml", "--bandwidth", case.bandwidth, "--out", "diagnosis")
    limo("diagnose", "second.parquet", *options)
    motion = Path("diagnosis/next_motion.parquet")
    return {
        "verdict": json_of("diagnosis/verdict.json"),
        "sim": yaml_of("diagnosis/sim.yaml"),
        "next_motion": table_of(motion) if motion.is_file() else None,
    }


def _joint_physics(case: Case) -> dict[str, Any]:
    return _trained(case, "joint_physics", "--model", "joint-physics")


def _network(case: Case) -> dict[str, Any]:
    fixed = ("--seed", 3, "--folds", 2, "--device", "cpu")
    return _trained(case, "network", *case.network, *fixed)


def _trained(case: Case, out: str, *options: object) -> dict[str, Any]:
    """Train on the second stretch, and predict it, from all of it and from the past alone."""
    given = ("--sim", "believed.yaml", "--bandwidth", case.bandwidth, "--out", out)
    printed = limo("train", "second.parquet", *given, *options, "--json")
    limo("predict", "second.parquet", "--model", out, "--out", "of_model.parquet")
    late = ("--delay", DELAY, "--out", "late.parquet")
    limo("predict", "second.parquet", "--model", out, *late)
    return {
        "printed": json.loads(printed),
        "manifest": _computed(json.loads(Path(out, "manifest.json").read_text(encoding="utf-8"))),
        "weights": _weights(f"{out}/model.safetensors"),
        "sim": yaml_of(f"{out}/sim.yaml"),
        "predicted": table_of("of_model.parquet"),
        "predicted_late": table_of("late.parquet"),
    }


def _weights(path: str) -> dict[str, Any]:
    """Return a summary of each array; of a root of a covariance, whose signs are free, of that."""
    arrays = dict(sorted(load_file(path).items()))
    if "root" in arrays:
        root = arrays.pop("root")  # (n, K, K)
        arrays["covariance"] = root.swapaxes(1, 2) @ root
    return {name: summary(array) for name, array in arrays.items()}


def _predict(case: Case) -> dict[str, Any]:
    sim = ("--sim", "believed.yaml", "--bandwidth", case.bandwidth)
    printed = limo("predict", "second.parquet", *sim, "--out", "torque.parquet", "--json")
    limo("predict", "second.parquet", *sim, "--delay", DELAY, "--out", "late.parquet")
    return {
        "printed": json.loads(printed),
        "predicted": table_of("torque.parquet"),
        "predicted_late": table_of("late.parquet"),
    }


STAGES: Mapping[str, Callable[[Case], dict[str, Any]]] = {
    "identify": _identify,
    "joint_physics": _joint_physics,
    "network": _network,
    "diagnose": _diagnose,
    "predict": _predict,
}


TOLERANCES: Mapping[str, float] = {  # of each stage on another processor
    "identify": FITS,
    "joint_physics": FITS,
    "network": TRAINED,
    "diagnose": FITS,
    "predict": SUMS,
}


def values_of(name: str, stages: Sequence[str], folder: Path) -> dict[str, Any]:
    """Return what the commands of some stages make, by stage, as JSON would hold it.

    Args:
        name: Of a case, whose files `prepare` has put into the folder.
        stages: Of `STAGES`.
        folder: To run in.
    """
    return computed_apart(__file__, name, folder, *stages)


def computed_apart(script: str, name: str, folder: Path, *stages: str) -> dict[str, Any]:
    """Return what a script writes by `write_values`, in a process of its own.

    It runs once more in another one if numba compiled anything there: a process that compiles a
    function computes with other last digits than all later ones, which load it from the cache.
    """
    for _ in ("compiling, perhaps", "computing"):
        command = (sys.executable, script, name, str(folder), *stages)
        done = subprocess.run(command, check=False, capture_output=True, text=True)
        if done.returncode:
            raise CommandFailedError(command, done.returncode, done.stderr.strip())
        made = json.loads((folder / _VALUES).read_text(encoding="utf-8"))
        if not made["compiled"]:
            break
    return made["stages"]


def write_values(place: str, stages: Mapping[str, Callable[[], Any]]) -> None:
    """Write values of stages, computed in a folder, and the functions compiled on the way.

    BLAS and OpenMP keep to one thread, since the number of threads decides the order of sums.
    """
    listener = RecordingListener()
    folder = Path(place).resolve()
    with install_listener("numba:compile", listener), chdir(folder), threadpool_limits(1):
        values = {name: compute() for name, compute in stages.items()}
    dispatchers = [event.data["dispatcher"] for _, event in listener.buffer if event.is_start]
    compiled = sorted({str(each) for each in dispatchers})
    text = json.dumps({"compiled": compiled, "stages": values}, indent=1)
    text = text.replace(f"{folder}/", "")  # a model keeps the whole path of its robot
    (folder / _VALUES).write_text(text, encoding="utf-8")


def yaml_of(path: str) -> Any:
    return _unversioned(yaml.safe_load(Path(path).read_text(encoding="utf-8")))


def json_of(path: str) -> Any:
    return _unversioned(json.loads(Path(path).read_text(encoding="utf-8")))


def _unversioned(content: dict[str, Any]) -> dict[str, Any]:
    """Leave out which limo wrote it, which each release changes."""
    return {key: value for key, value in content.items() if key != "limo"}


def table_of(path: str | Path) -> dict[str, Any]:
    """Return a summary of each column; an empty row is not a number."""
    table = pq.read_table(path)
    return {
        name: summary(table[name].to_numpy(zero_copy_only=False)) for name in table.column_names
    }


def _computed(values: Any) -> Any:
    """Return values without the entries that say what files and packages there were."""
    if isinstance(values, dict):
        return {key: _computed(item) for key, item in values.items() if key not in LEFT_OUT}
    return [_computed(item) for item in values] if isinstance(values, list) else values


if __name__ == "__main__":
    _name, _folder, *_stages = sys.argv[1:]
    write_values(_folder, {stage: partial(STAGES[stage], CASES[_name]) for stage in _stages})
