"""Whether odd and drifting arms of a concealed fleet are found, and how workers share the work.

    python benchmarks/fleet/concealed_fleet.py [--arms 6] [--dates 9] [--seconds 20]

The arms are the concealed plant, which shares no code with limo; each unit has its own friction.
One has twice the dry friction of the others at joint 2; at another, viscous friction of joint 4
grows to three times over the dates. Bars: these two are named and no other; two workers do 1.8
times the work of one (by the clock, same run, after one recording has compiled what is compiled).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import yaml

import limo_driver as limo

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import arm as arm_
import motions
from acquisition import Instruments
from world import COULOMB, VISCOUS, World

ODD, DRIFTING = 1, 3  # arms, and 0-based joints of theirs
UNITS = 0.05  # by which friction differs from unit to unit, relative


def make(folder: Path, arms: int, dates: int, seconds: float) -> None:
    """Record the fleet and write the simulation that is believed of it."""
    random = np.random.default_rng(1)
    world = World.draw(random)
    instruments = Instruments.draw(random)
    _, limits = arm_.load()
    for j in range(arm_.N):
        world = world.with_drive(j, coulomb=COULOMB[j], viscous=VISCOUS[j])
    world = world.with_nominal(coulomb=COULOMB, viscous=VISCOUS)
    (folder / "sim.yaml").write_text(yaml.safe_dump(world.simulation_file(random)))
    for k in range(arms):
        unit = world
        for j in range(arm_.N):
            off = 1 + UNITS * random.standard_normal(2)
            if (k, j) == (1, ODD):
                off[0] *= 2
            unit = unit.with_drive(j, coulomb=COULOMB[j] * off[0], viscous=VISCOUS[j] * off[1])
        place = folder / "recordings" / f"arm{k}"
        place.mkdir(parents=True)
        for day in range(dates):
            now = unit
            if k == 2:
                grown = 1 + 2 * day / (dates - 1)
                now = unit.with_drive(DRIFTING, viscous=VISCOUS[DRIFTING] * grown)
            motion, _ = motions.recording(["fourier"], seconds, limits, random)
            felt = now.respond(motion, 0, random)
            taken = instruments.record(felt, now.sensing, 0)
            recording = limo.Recording.from_arrays(taken.time, taken.position, taken.torque)
            recording.save(place / f"{date(2026, 3, 1) + timedelta(days=7 * day)}.parquet")


def main() -> None:
    """Make, diagnose with one worker and with two, and print the figures beside the bars."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--arms", type=int, default=6)
    given.add_argument("--dates", type=int, default=9)
    given.add_argument("--seconds", type=float, default=20.0)
    asked = given.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder, asked.arms, asked.dates, asked.seconds)
        pattern, sim = f"{folder}/recordings/**/*.parquet", folder / "sim.yaml"
        limo.diagnose_fleet(f"{folder}/recordings/arm0/2026-03-01*", sim, folder / "warm")
        took: dict[int, float] = {}
        for workers in (1, 2):
            start = time.perf_counter()
            found = limo.diagnose_fleet(pattern, sim, folder / str(workers), workers=workers)
            took[workers] = time.perf_counter() - start
            print(f"{workers} workers: {took[workers]:.1f} s, {len(found.rows)} recordings")
        print(found)
        print(f"odd: {found.odd} (bar: arm1); drifting: {found.drifting} (bar: arm2)")
        print(f"two workers do {took[1] / took[2]:.2f} times the work of one (bar: 1.8)")
        kept = sum(p.stat().st_size for p in (folder / "2").rglob("*") if p.is_file())
        print(f"kept of each recording: {kept / len(found.rows) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
