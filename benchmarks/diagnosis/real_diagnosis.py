"""Diagnosis of real arms: what `limo diagnose` says of recordings that nobody made for it.

Each case runs the commands a user would type: `limo identify` on some recordings of an arm, then
`limo diagnose` on others. The errors are those on a recording that neither command was given: root
mean square of the difference between predicted and measured torque, both low-passed forward and
backward at 8 Hz. The folder with the recordings is named by LIMO_DATA, or is ../shared/data.

    python benchmarks/diagnosis/real_diagnosis.py [--only CASE]
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pinocchio

from limo_driver.physics import Simulation
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

BANDWIDTH = 8.0  # [Hz]
DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
EXAMPLE_ROBOTS = Path(pinocchio.__file__).parents[4] / "share/example-robot-data/robots"
UR10E = DATA / "ur10e"
LWR4 = DATA / "kuka_lwr4"
PANDA = DATA / "panda/exciting_trajectory.parquet"
SHOWN = {"mass", "com", "coefficient", "variant", "gain", "offset", "delay", "tau_s", "law"}


@dataclass(frozen=True)
class Case:
    """An arm, what its simulation is identified from, what is diagnosed, and what is predicted."""

    name: str
    urdf: Path
    identified: tuple[Path, ...]
    diagnosed: tuple[Path, ...]
    predicted: Path
    expected: str
    options: str = ""  # of `limo identify`


@dataclass(frozen=True)
class Outcome:
    """What the commands of a case wrote, and the errors on the recording kept apart."""

    commands: tuple[str, ...]
    verdict: dict[str, Any]
    before: FloatArray  # (n,) [N m]
    after: FloatArray  # (n,) [N m]
    seconds: float  # of `limo diagnose`

    @property
    def fall(self) -> float:
        """Return by how much the error falls, in the geometric mean over joints."""
        return 1.0 - float(np.exp(np.log(self.after / self.before).mean()))


def ur10e(run: str) -> Path:
    """Return the file of a run of the UR10e."""
    return UR10E / f"{run}.parquet"


def cases(scratch: Path) -> list[Case]:
    """Return the cases whose recordings are there; parts of recordings are written to `scratch`."""

    def ur(name: str, diagnosed: str, predicted: str, expected: str) -> Case:
        learned = (ur10e("unloaded_14harm"),)
        moving = "--moving-only"  # its torques come from currents
        files = (ur10e(diagnosed),)
        return Case(name, UR10E / "ur10e.urdf", learned, files, ur10e(predicted), expected, moving)

    load = "payload of 2.805 kg by its owners; about 3.0 kg of it by the current gains"
    lwr4 = tuple(LWR4 / f"measurements_{run}.parquet" for run in (2, 3))
    panda = split(PANDA, scratch)
    fall = "what is left out is named; error falls by 30 %"
    return [
        ur("ur10e-unloaded", "unloaded_15harm", "unloaded_20_01_31", "no payload"),
        ur("ur10e-loaded", "loaded_14harm", "loaded_20_01_31", load),
        ur("ur10e-loaded-again", "loaded_20_01_31", "loaded_14harm", load),
        ur("ur10e-loaded-turned", "loaded_15harm_corrupt_rows", "loaded_14harm", load),
        Case("lwr4", LWR4 / "kuka_lwr4.urdf", lwr4, lwr4, LWR4 / "measurements_1.parquet", fall),
        Case(
            "panda",
            EXAMPLE_ROBOTS / "panda_description/urdf/panda.urdf",
            panda[:1],
            panda[:1],
            panda[1],
            fall,
        ),
    ]


def split(path: Path, scratch: Path) -> tuple[Path, Path]:
    """Write the first two thirds and the last third of a recording."""
    recording = Recording.load(path)
    at = 2 * len(recording) // 3
    first, last = scratch / "first_two_thirds.parquet", scratch / "last_third.parquet"
    recording[:at].save(first)
    recording[at:].save(last)
    return first, last


def run(case: Case, folder: Path) -> Outcome:
    """Run the two commands of a case, and predict the recording that they were not given.

    Raises:
        subprocess.CalledProcessError: A command did not finish; its message is on stderr.
    """
    sim, out = folder / f"{case.name}.yaml", folder / case.name
    band = f"--bandwidth {BANDWIDTH:g}"
    identify = (
        f"identify {_files(case.identified)} --robot {case.urdf} {case.options} {band} --out {sim}"
    )
    diagnose = f"diagnose {_files(case.diagnosed)} --sim {sim} {band} --out {out}"
    _limo(identify)
    start = time.perf_counter()
    _limo(diagnose)
    seconds = time.perf_counter() - start
    recording = Recording.load(case.predicted)
    return Outcome(
        tuple(f"limo {' '.join(command.split())}" for command in (identify, diagnose)),
        json.loads((out / "verdict.json").read_text()),
        rmse(sim, recording),
        rmse(out / "sim.yaml", recording),
        seconds,
    )


def _files(paths: tuple[Path, ...]) -> str:
    return " ".join(str(path) for path in paths)


def _limo(command: str) -> None:
    main_of_limo = "from limo_driver.app.cli import main; main()"
    subprocess.run(
        [sys.executable, "-c", main_of_limo, *shlex.split(command)],
        check=True,
        stdout=subprocess.DEVNULL,
    )


def rmse(sim: Path, recording: Recording) -> FloatArray:
    """Return the error of a simulation on each joint of a recording, (n,) [N m]."""
    predicted = Simulation.load(sim).predict(recording, BANDWIDTH)
    predicted = smooth(recording.time, predicted, BANDWIDTH, recording.segments)
    error = recording.filtered_torque(BANDWIDTH) - predicted
    return np.sqrt(np.mean(error**2, axis=0))


def show(case: Case, outcome: Outcome) -> None:
    """Print what was done, what was found, and what it was good for."""
    verdict = outcome.verdict
    print(f"\n## {case.name} (expected: {case.expected})")
    for command in outcome.commands:
        print(f"$ {command}")
    print(f"{verdict['verdict']}, in {outcome.seconds:.0f} s; rows {verdict['rows']}")
    for item in verdict["findings"]:
        same = f" = {', '.join(item['equivalent'])}" if item["equivalent"] else ""
        print(
            f"  {item['kind']} {item['effect']}{same}, joints {item['joints']}, "
            f"confidence {item['confidence']:.2f}, share {item['share']:.2f}"
        )
        for name, value in item["parameters"].items():
            if name in SHOWN:
                print(f"    {name} = {_rounded(value['value'])} {_rounded(value['ci95'])}")
    print(f"  RMSE [N m] on {case.predicted.name}, which neither command was given:")
    for name, values in (("given", outcome.before), ("improved", outcome.after)):
        print(f"    {name:9}" + "".join(f"{value:8.3f}" for value in values))
    print(f"  falls by {outcome.fall:.0%} in the geometric mean over joints", flush=True)


def _rounded(value: Any) -> Any:  # noqa: ANN401  # JSON values
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    """Run the cases and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", help="names of cases")
    options = parser.parse_args()
    if not DATA.is_dir():
        parser.error(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    with TemporaryDirectory() as folder:
        for case in cases(Path(folder)):
            if options.only and case.name not in options.only:
                continue
            try:
                show(case, run(case, Path(folder)))
            except subprocess.CalledProcessError as error:
                print(f"\n## {case.name}: failed with exit status {error.returncode}", flush=True)


if __name__ == "__main__":
    main()
