"""Pushes that are added to real recordings: how many does a diagnosis name, and when?

    python benchmarks/diagnosis/diagnosis_pushes.py [--only ur10e lwr4 panda] [--draws 2] [--each 2]
        [--scan]

`--scan` runs the search for pushes alone, beside the simulation that the diagnosis of the
recordings as they are came to: seconds instead of minutes, so many draws. What a search for effects
makes of pushes is then left out.

Each arm's simulation is identified as `real_diagnosis.py` does it. The diagnosis of its recordings
as they are comes first; whatever is named there is counted as false. Then `--each` pushes are added
to the measured torque of a recording, as far as there is room: a force on any point of any link but
the first, as a hit that rebounds, as a human push, or held. Their size is so many times what the
joints' errors usually are (root mean square of what the simulation leaves where a joint moves), at
the joint that feels it most, after the filter. A push counts as named if its start and end are met
within 0.2 s, and as touched if its time overlaps. The arm itself does not give way as it would
under a real hit.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from real_diagnosis import BANDWIDTH, DATA, cases, rmse

import limo_driver as limo
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.pushes import pushes
from estimators.rigid_body.fitting.normal_equations import Rows
from limo_driver.recordings.filters.differentiation import smooth

if TYPE_CHECKING:
    from real_diagnosis import Case

    from limo_driver.types import FloatArray

SIZES = (5.0, 8.0, 15.0)  # times the usual error
NEAR = 0.2  # [s]
APART = 3.0  # [s] between pushes
Window = tuple[int, float, float]  # recording (0-based), start and end [s]
ARMS = {"ur10e": "ur10e-unloaded", "lwr4": "lwr4", "panda": "panda"}


@dataclass(frozen=True)
class Added:
    """A push that was added."""

    recording: int  # 0-based
    start: float  # [s]
    end: float  # [s]
    kind: str


def course(kind: str, random: np.random.Generator, time: FloatArray) -> tuple[FloatArray, float]:
    """Return how strong a push is at times since its start (T,), at most 1, and how long it is."""
    if kind == "held":
        length = random.uniform(0.5, 2.0)
        ends = np.minimum(time, length - time)
        return np.clip(ends / 0.1, 0.0, 1.0), length
    length = random.uniform(0.06, 0.3) if kind == "hit" else random.uniform(0.3, 1.5)
    strength = np.where((time >= 0) & (time < length), np.sin(np.pi * time / length), 0.0)
    if kind == "hit":
        after = np.clip(time - length, 0.0, None)
        swing = np.sin(2 * np.pi * random.uniform(3.0, 8.0) * after) * np.exp(-after / 0.12)
        strength -= random.uniform(0.2, 0.5) * swing
    return strength, length


def torque_of(
    model: limo.RobotModel, position: FloatArray, link: int, point: FloatArray, force: FloatArray
) -> FloatArray:
    """Return the torque (T, n) that a force (3,) on a point of a link puts on the joints."""
    data, result = model.pin_model.createData(), np.zeros_like(position)
    for t, q in enumerate(position):
        pin.computeJointJacobians(model.pin_model, data, q)
        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        jacobian = pin.getJointJacobian(model.pin_model, data, link + 1, frame)
        lever = data.oMi[link + 1].rotation @ point
        result[t] = -(jacobian[:3] - pin.skew(lever) @ jacobian[3:]).T @ force
    return result


def pushed(
    model: limo.RobotModel,
    recordings: list[limo.Recording],
    usual: FloatArray,
    size: float,
    random: np.random.Generator,
    each: int,
) -> tuple[list[limo.Recording], list[Added]]:
    """Return the recordings with so many pushes in each, and what was added."""
    result, added = [], []
    for number, recording in enumerate(recordings):
        time, torque = recording.time, np.array(recording.torque)
        mine: list[Added] = []
        for _ in range(20 * each):
            if len(mine) == each:
                break
            start = float(random.uniform(time[0] + 1.0, time[-1] - 3.0))
            kind = str(random.choice(["hit", "push", "held"]))
            if any(abs(other.start - start) < APART for other in mine):
                continue
            strength, length = course(kind, random, time - start)
            link = int(random.integers(1, recording.n))
            force = random.normal(size=3)
            near = (time > start - 0.2) & (time < start + length + 1.2)
            own = np.zeros_like(torque)
            own[near] = strength[near, None] * torque_of(
                model, recording.position[near], link, 0.1 * random.normal(size=3), force
            )
            felt = smooth(time, own, BANDWIDTH, recording.segments)
            most = float((np.abs(felt) / usual).max())
            torque += size / most * own
            mine.append(Added(number, start, start + length, kind))
        added += mine
        result.append(replace(recording, torque=torque))
    return result, added


def windows(found: limo.Diagnosis) -> list[Window]:
    """Return recording (0-based), start and end [s] of the pushes that are named."""
    return [
        (recording - 1, *window)
        for item in found.verdict.findings
        if item.effect == "external_contact"
        for recording, window in zip(item.where.recording, item.where.time, strict=True)
    ]


def scanned(simulation: limo.Simulation, recordings: list[limo.Recording]) -> list[Window]:
    """Return what the search for pushes finds by itself, as `windows` has it."""
    observed = Observations.of(simulation, recordings, BANDWIDTH)
    return [(push.recording, push.start, push.end) for push in pushes(observed, observed.residual)]


def run(case: Case, folder: Path, draws: int, each: int, *, scan: bool) -> dict[float, list[int]]:
    """Print and return, by size, pushes added, touched, named, and false ones."""
    learned = [limo.Recording.load(path) for path in case.identified]
    given = [limo.Recording.load(path) for path in case.diagnosed]
    model = limo.RobotModel.load(case.urdf)
    rows = Rows(bandwidth=BANDWIDTH, moving_only="--moving-only" in case.options)
    simulation = limo.identify(model, learned, rows=rows).simulation
    simulation.save(folder / "sim.yaml")
    plain = limo.diagnose(simulation, given, bandwidth=BANDWIDTH)
    false = windows(plain)
    usual = np.mean([rmse(folder / "sim.yaml", recording) for recording in given], axis=0)
    print(f"{case.name}: {len(false)} named where none was added")
    table: dict[float, list[int]] = {}
    for size in SIZES:
        count = table.setdefault(size, [0, 0, 0, 0])
        for draw in range(draws):
            random = np.random.default_rng([int(size), draw])
            recordings, added = pushed(model, given, usual, size, random, each)
            if scan:
                found = scanned(plain.simulation, recordings)
            else:
                found = windows(limo.diagnose(simulation, recordings, bandwidth=BANDWIDTH))
            for one in added:
                close = [
                    (abs(start - one.start), abs(end - one.end))
                    for recording, start, end in found
                    if recording == one.recording and start < one.end and end > one.start
                ]
                count[0] += 1
                count[1] += bool(close)
                count[2] += any(max(pair) <= NEAR for pair in close)
            count[3] += sum(
                not any(
                    recording == one.recording and start < one.end + 0.5 and end > one.start - 0.5
                    for one in added
                )
                for recording, start, end in found
            )
        print(f"  {size:g} x: {count[1]} of {count[0]} touched, {count[2]} named, {count[3]} false",
              flush=True)  # fmt: skip
    return table


def main() -> None:
    """Run the arms and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", choices=list(ARMS), default=list(ARMS))
    parser.add_argument("--scan", action="store_true", help="the search for pushes alone")
    parser.add_argument("--draws", type=int, default=2, help="for each size")
    parser.add_argument("--each", type=int, default=2, help="in each recording, apart")
    options = parser.parse_args()
    if not DATA.is_dir():
        parser.error(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    total = np.zeros(4, dtype=int)
    with TemporaryDirectory() as folder:
        for case in cases(Path(folder)):
            if case.name in {ARMS[name] for name in options.only}:
                for count in run(
                    case, Path(folder), options.draws, options.each, scan=options.scan
                ).values():
                    total += count
    print(f"all: {total[1] / total[0]:.0%} touched, {total[2] / total[0]:.0%} named within "
          f"{NEAR:g} s [80 %], {total[3]} false")  # fmt: skip


if __name__ == "__main__":
    main()
