"""Whether odd and drifting arms of a concealed fleet are found, and how workers share the work.

    python benchmarks/fleet/concealed_fleet.py [--arms 6] [--dates 9] [--seconds 20]
    python benchmarks/fleet/concealed_fleet.py --arms 20 --dates 15 --seconds 60 --keep FOLDER

The arms are the concealed plant, which shares no code with limo; each unit has its own friction.
`PECULIAR` says which units are more than that: of 20 arms, three are odd and two drift. Bars: these
are named and no other; two workers do 1.8 times the work of one (by the clock, same run, after one
recording has compiled what is compiled). With a folder that is kept, as many recordings run as
there are cores, once, and the same command goes on where it was ended.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml

import limo_driver as limo

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "concealed"))

import arm as arm_
import motions
from acquisition import Instruments
from world import COULOMB, VISCOUS, World

if TYPE_CHECKING:
    from estimators.studies import FleetDiagnosis

# Of a unit, at a part of its dates: 0 is the first, 1 the last.
Change = Callable[[World, float], World]


def _drive(joint: int, **times: Callable[[float], float]) -> Change:
    """Multiply friction of a drive.

    Args:
        joint: 0-based.
        times: By what, over the dates, for each name.
    """

    def change(world: World, at: float) -> World:
        now = {name: world.drive[name][joint] * by(at) for name, by in times.items()}
        return world.with_drive(joint, **now)

    return change


def _tool(world: World, _: float) -> World:
    """Leave a tool of 1.2 kg at the flange of which the simulation knows nothing."""
    inertia, com = 2e-3 * np.eye(3), np.array([0.0, 0.02, 0.08])
    return replace(world, arm=arm_.add_body(world.arm, arm_.N - 1, 1.2, com, inertia))


PECULIAR: dict[int, tuple[str, Change]] = {  # by arm
    1: ("odd", _drive(1, coulomb=lambda _: 2.0)),
    2: ("drifting", _drive(3, viscous=lambda at: 1 + 2 * at)),
    7: ("odd", _drive(4, viscous=lambda _: 2.0)),
    9: ("drifting", _drive(0, coulomb=lambda at: 1 - 0.5 * at)),  # runs in
    12: ("odd", _tool),
}
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
    believed = world.simulation_file(random)
    for k in range(arms):
        unit = world
        for j in range(arm_.N):
            off = 1 + UNITS * random.standard_normal(2)
            unit = unit.with_drive(j, coulomb=COULOMB[j] * off[0], viscous=VISCOUS[j] * off[1])
        place = folder / "recordings" / f"arm{k}"
        place.mkdir(parents=True, exist_ok=True)
        for day in range(dates):
            now = PECULIAR[k][1](unit, day / (dates - 1)) if k in PECULIAR else unit
            motion, _ = motions.recording(["fourier"], seconds, limits, random)
            felt = now.respond(motion, 0, random)
            taken = instruments.record(felt, now.sensing, 0)
            recording = limo.Recording.from_arrays(taken.time, taken.position, taken.torque)
            recording.save(place / f"{date(2026, 3, 1) + timedelta(days=7 * day)}.parquet")
    (folder / "sim.yaml").write_text(yaml.safe_dump(believed))  # last: all is there


def expected(kind: str, arms: int) -> set[str]:
    """Return the arms that have to be named."""
    return {f"arm{k}" for k, (of, _) in PECULIAR.items() if of == kind and k < arms}


def shared(pattern: str, folder: Path) -> FleetDiagnosis:
    """Diagnose with one worker and with two, and print what two are worth."""
    limo.diagnose_fleet(
        pattern.replace("**/*", "arm0/2026-03-01"), folder / "sim.yaml", folder / "warm"
    )
    took: dict[int, float] = {}
    for workers in (1, 2):
        start = time.perf_counter()
        found = limo.diagnose_fleet(
            pattern, folder / "sim.yaml", folder / str(workers), workers=workers
        )
        took[workers] = time.perf_counter() - start
        print(f"{workers} workers: {took[workers]:.1f} s, {len(found.rows)} recordings")
    print(f"two workers do {took[1] / took[2]:.2f} times the work of one (bar: 1.8)")
    return found


def main() -> None:
    """Make a fleet, diagnose it, and print what is named beside what is concealed."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--arms", type=int, default=6)
    given.add_argument("--dates", type=int, default=9)
    given.add_argument("--seconds", type=float, default=20.0)
    given.add_argument("--keep", type=Path, help="Folder for the fleet and its diagnosis.")
    given.add_argument("--workers", type=int, help="With --keep; one for each core if not given.")
    asked = given.parse_args()
    with nullcontext(asked.keep) if asked.keep else tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if not (folder / "sim.yaml").exists():
            make(folder, asked.arms, asked.dates, asked.seconds)
        pattern = f"{folder}/recordings/**/*.parquet"
        if asked.keep:
            found = limo.diagnose_fleet(
                pattern, folder / "sim.yaml", folder / "fleet", workers=asked.workers
            )
        else:
            found = shared(pattern, folder)
        print(found)
        for kind, named in (("odd", found.odd), ("drifting", found.drifting)):
            wanted = expected(kind, asked.arms)
            print(f"{kind}: {', '.join(named)} (bar: {', '.join(sorted(wanted))})")
            print(f"  missed {sorted(wanted - set(named))}, wrong {sorted(set(named) - wanted)}")
        spent = sum(row.seconds for row in found.rows)
        print(f"a recording: {spent / len(found.rows):.2f} s")


if __name__ == "__main__":
    main()
