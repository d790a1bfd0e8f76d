"""False alarms of contact in an hour, and pushes that are told, by compiled C.

Concealed arms of `tests/concealed`, which share no code with limo: each is identified and learned
from two motions, its thresholds come from others that nothing touched, and it is judged on motions
of its own, of all kinds: creep, reversals, points, Fourier series, LIMOPA. Seeds follow from the
version, see `benchmarks/diagnosis/fresh.py`. With `--real`, recordings of real arms, each motion in
turn judged with thresholds of the others.

    python benchmarks/estimators/contacts.py [--arms 6] [--motions 20] [--alone] [--real]

A push adds torque at one joint for half a second. It is told where the joint is said to be in
contact within a quarter of a second after its end; late is from its begin to that state.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))
sys.path.insert(0, str(Path(__file__).parents[1] / "diagnosis"))

import arm as arm_
import lifelike
import motions
from acquisition import Instruments
from fresh import first_seed

import limo_driver as limo
from estimators.embedded.export import CodeExport, export_c
from limo_driver.errors import LimoError
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
RATE, SECONDS = 250.0, 60.0  # [Hz], [s] of a motion
ALARMS = 1.0  # [1/h], asked for
APART = 0.2  # [s] between beginnings of two alarms
SIZES = (1.5, 3.0)  # times the joint's median threshold
PUSH, AFTER = 0.5, 0.25  # [s]
FLAGS = ("-std=c11", "-O2", "-march=native")


@dataclass
class Figures:
    """Sums over motions."""

    hours: float = 0.0
    alarms: int = 0
    known: float = 0.0  # of rows and joints, times hours

    def show(self, name: str, more: str = "") -> None:
        """Print a line."""
        rate = self.alarms / self.hours
        print(
            f"{name:34}{self.hours:6.2f} h {self.alarms:4d} false = {rate:6.2f} an hour,"
            f" known {self.known / self.hours:4.0%}{more}",
            flush=True,
        )


class Judged:
    """An exported model, and what it says of motions."""

    def __init__(self, model: Any, free: Sequence[Recording], folder: Path) -> None:  # noqa: ANN401
        rate = float(np.median([own.rate for own in free]))
        self.export: CodeExport = export_c(model, folder, rate, false_alarms=ALARMS, free=free)
        self.program = folder / "contacts"
        sources = [str(Path(__file__).with_name("contact_loop.c")), str(folder / "limo.c")]
        command = ["gcc", *FLAGS, f"-I{folder}", *sources, "-o", str(self.program), "-lm"]
        subprocess.run(command, check=True)

    def run(self, moved: Recording, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return thresholds and flags, (T, n) each."""
        rows = np.column_stack([moved.time, moved.position, torque])
        done = subprocess.run([self.program], input=rows.tobytes(), capture_output=True, check=True)
        found = np.frombuffer(done.stdout).reshape(len(rows), 3, moved.n)
        return found[:, 1], found[:, 2]

    def judge(self, moved: Recording, total: Figures) -> FloatArray:
        """Add what is said of free motion; return the joints' median thresholds where known."""
        threshold, flags = self.run(moved, moved.torque)
        contact, known = (flags % 2 > 0).any(axis=1), flags >= 2
        begun = moved.time[1:][np.diff(contact.astype(int)) > 0]
        total.alarms += int(np.sum(np.diff(begun, prepend=-np.inf) > APART))
        hours = (moved.time[-1] - moved.time[0]) / 3600.0
        total.hours += hours
        total.known += hours * float(known.mean())
        return np.nanmedian(np.where(known, threshold, np.nan), axis=0)

    def push(
        self, moved: Recording, level: FloatArray, size: float, random: np.random.Generator
    ) -> list[float]:
        """Push each joint once; return how late it was told [s], NaN where it was not."""
        torque, time = moved.torque.copy(), moved.time
        starts = np.linspace(time[0] + 2.0, time[-1] - 2.0, moved.n) + random.uniform(-1, 0)
        order, signs = random.permutation(moved.n), random.choice([-1.0, 1.0], moved.n)
        for j, start, sign in zip(order, starts, signs, strict=True):
            torque[(time >= start) & (time < start + PUSH), j] += sign * size * level[j]
        _, flags = self.run(moved, torque)
        late: list[float] = []
        for j, start in zip(order, starts, strict=True):
            if np.isfinite(level[j]):
                during = (time >= start) & (time < start + PUSH + AFTER) & (flags[:, j] % 2 > 0)
                late.append(float(time[during][0] - start) if during.any() else np.nan)
        return late


def measured(
    name: str,
    model: Any,  # noqa: ANN401
    free: Sequence[Recording],
    others: Sequence[Recording],
    total: Figures,
    random: np.random.Generator,
) -> list[list[float]]:
    """Judge one model; print a line, and return how late pushes of each size were told."""
    own, late = Figures(), list[list[float]]([[] for _ in SIZES])
    with tempfile.TemporaryDirectory() as folder:
        try:
            judged = Judged(model, free, Path(folder))
        except LimoError as error:
            print(f"{name:34}{error}", flush=True)
            return late
        levels = [judged.judge(moved, own) for moved in others]
        for moved, level in zip(others, levels, strict=True):
            for k, size in enumerate(SIZES):
                late[k] += judged.push(moved, level, size, random)
    contact = judged.export.contact
    assert contact is not None
    low, high = contact.rates
    with np.errstate(all="ignore"):
        median = np.nanmedian(levels, axis=0)
    thresholds = " ".join(f"{value:.1f}" for value in median)
    own.show(name, f"; {low:.1g} to {high:.1g} said; above {thresholds} N m")
    for field in ("hours", "alarms", "known"):
        setattr(total, field, getattr(total, field) + getattr(own, field))
    return late


def told(late: list[list[float]]) -> None:
    """Print which pushes were told."""
    for size, found in zip(SIZES, late, strict=True):
        times = np.array(found)
        seen = np.isfinite(times)
        median, worst = np.percentile(times[seen], [50, 90]) if seen.any() else (np.nan,) * 2
        print(
            f"pushes of {size:g} thresholds: {seen.sum()} of {times.size} told ({seen.mean():.0%}),"
            f" median {1e3 * median:.0f} ms, 90 % within {1e3 * worst:.0f} ms"
        )


class Concealed:
    """One arm that shares no code with limo, and its recordings."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng([seed, 52])
        self.world = lifelike.draw(self.random)
        self.instruments = replace(Instruments.draw(self.random), rate=RATE)
        _, self.limits = arm_.load()
        self.made = 0

    def record(self, kinds: Sequence[str]) -> Recording:
        """Record a motion of these kinds, some `SECONDS` long."""
        motion, _ = motions.recording(list(kinds), SECONDS, self.limits, self.random)
        response = self.world.respond(motion, 4, self.random)
        self.made += 1
        own = self.instruments.record(response, self.world.sensing, 1000 + self.made)
        rising = np.append(True, np.diff(own.time) > 0.2 / RATE)  # jitter at its ends
        return Recording.from_arrays(own.time[rising], own.position[rising], own.torque[rising])

    def mixed(self) -> Recording:
        """Record a motion of three kinds that are drawn."""
        moving = [kind for kind in motions.KINDS if kind != "hold"]
        return self.record(self.random.choice(moving, 3, replace=False))


def of_concealed(first: int, arms: int, count: int, *, alone: bool) -> None:
    """Print the figures of concealed arms."""
    total, late = Figures(), list[list[float]]([[] for _ in SIZES])
    for seed in range(first, first + arms):
        own = Concealed(seed)
        learned = [own.record(("limopa", "creep")), own.record(("fourier", "nested", "points"))]
        simulation = limo.identify("iiwa14", learned).simulation
        model = simulation if alone else limo.train(simulation, learned, "joint-physics")
        free = [own.mixed() for _ in range(8)]
        others = [own.mixed() for _ in range(count)]
        found = measured(f"concealed {seed}", model, free, others, total, own.random)
        late = [one + more for one, more in zip(late, found, strict=True)]
    total.show("all")
    told(late)


def of_real(*, alone: bool) -> None:
    """Print the figures of real arms, each motion judged in turn."""
    from real_recordings import at_rate, panda_urdf

    ur = [f"ur10e/unloaded_{name}.parquet" for name in ("14harm", "15harm", "20_01_31")] + [
        "ur10e/unloaded_point_to_point.parquet"
    ]
    lwr = [f"kuka_lwr4/measurements_{run}.parquet" for run in (1, 2, 3)]
    panda = at_rate(Recording.load(DATA / "panda/exciting_trajectory.parquet"), 500.0)
    thirds = [panda[k * len(panda) // 3 : (k + 1) * len(panda) // 3] for k in range(3)]
    cases = {
        "UR10e": (DATA / "ur10e/ur10e.urdf", [Recording.load(DATA / name) for name in ur]),
        "LWR4+": (DATA / "kuka_lwr4/kuka_lwr4.urdf", [Recording.load(DATA / name) for name in lwr]),
        "Panda": (panda_urdf(), thirds),
    }
    random = np.random.default_rng(0)
    total, late = Figures(), list[list[float]]([[] for _ in SIZES])
    for name, (urdf, recordings) in cases.items():
        for k, judged in enumerate(recordings):
            rest = recordings[k + 1 :] + recordings[:k]
            simulation = limo.identify(urdf, rest[:1]).simulation
            model = simulation if alone else limo.train(simulation, rest[:1], "joint-physics")
            title = f"{name} {Path(judged.source or str(k + 1)).stem}"
            found = measured(title, model, rest[1:], [judged], total, random)
            late = [one + more for one, more in zip(late, found, strict=True)]
    total.show("all")
    told(late)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=6)
    parser.add_argument("--motions", type=int, default=20, help="of a minute, of each arm")
    parser.add_argument("--first", type=int, help="seed; else by the version")
    parser.add_argument("--alone", action="store_true", help="a simulation that learned nothing")
    parser.add_argument("--real", action="store_true", help="recordings of real arms")
    given = parser.parse_args()
    print(f"{ALARMS:g} alarm an hour is asked for")
    if given.real:
        of_real(alone=given.alone)
    else:
        first = first_seed() if given.first is None else given.first
        of_concealed(first, given.arms, given.motions, alone=given.alone)


if __name__ == "__main__":
    main()
