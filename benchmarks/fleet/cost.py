"""What a fleet costs, by slopes: of a recording's length, and of the number of recordings.

    python benchmarks/fleet/cost.py [--rows 5000 10000 20000] [--dates 100] [--of 100000]

One recording of the concealed plant is diagnosed at each of several lengths, each in a process of
its own: CPU time, peak memory, room on the disk. Then fleets of more and more rows, 100 dates an
arm, go through what the command does around the diagnoses: knowing the recordings by their bytes,
keeping rows, reading back those that are finished, statistics, table and page. Lines through these
give the cost of many recordings of 60 s; beside each is the largest distance from its line,
relative to what was measured.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from shutil import copytree
from typing import TYPE_CHECKING

import numpy as np
from concealed_fleet import make

import limo_driver as limo
from estimators.studies.fleet import ROW, FleetDiagnosis, FleetStore
from estimators.studies.fleet_page import save_fleet
from estimators.studies.fleet_row import FleetOutcome
from limo_driver.app.library.fleets import FleetJob, rows_of

if TYPE_CHECKING:
    from estimators.studies.fleet_row import FleetRow

SECONDS = (20.0, 60.0, 120.0, 240.0)  # of a recording, at 250 Hz
KEPT = 100  # rows, each brought to the disk before the next
USUAL = 60.0  # [s]


def diagnose_one(folder: Path) -> None:
    """Diagnose the recording of a folder, keep it, and print what it took."""
    (file,) = folder.glob("recordings/arm0/*")
    (row,) = rows_of([file], "")
    job = FleetJob(limo.Simulation.load(folder / "sim.yaml"), None)
    start = time.process_time()
    outcome = job.do(row)
    took = time.process_time() - start
    assert isinstance(outcome, FleetOutcome), outcome
    store = FleetStore(folder / "fleet")
    store.keep(row.key, outcome)
    kept = sum(path.stat().st_size for path in store.place(row.key).iterdir())
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps([took, peak, kept, row.bytes]))


def fleet_of(folder: Path, count: int, dates: int) -> dict[str, float]:
    """Time what the command does around so many diagnoses, each a link to one [s].

    Recordings and rows on the disk are a tenth of them, to be done in a minute.
    """
    random = np.random.default_rng(1)
    (file,) = folder.glob("recordings/arm0/*")
    (row,) = rows_of([file], "")
    store = FleetStore(folder / "fleet")
    found: dict[str, float] = {}
    copies = count // 10
    start = time.perf_counter()
    for _ in range(copies):
        rows_of([file], "")
    found["bytes"] = (time.perf_counter() - start) * count / copies
    for k in range(copies):
        if not store.place(f"copy{k}").exists():
            copytree(store.place(row.key), store.place(f"copy{k}"), copy_function=os.link)
    start = time.perf_counter()
    for k in range(copies):
        assert store.finished(replace(row, key=f"copy{k}")) is not None
    found["rows read back"] = (time.perf_counter() - start) * count / copies
    written = [path for path in store.place(row.key).iterdir() if path.name != ROW]
    outcome = FleetOutcome(1.0, files={path.name: path.read_bytes() for path in written})
    start = time.perf_counter()
    for k in range(KEPT):
        store.keep(f"kept{k}", outcome)
    found["rows kept"] = (time.perf_counter() - start) * count / KEPT
    done = store.finished(row)
    assert done is not None
    assert done.verdict is not None
    rows: list[FleetRow] = []
    for k in range(count):
        fit = done.verdict.fit
        errors = tuple(e * np.exp(0.1 * random.standard_normal()) for e in fit.heldout_rmse_before)
        verdict = replace(done.verdict, fit=replace(fit, heldout_rmse_before=errors))
        day = datetime(2026, 3, 1) + timedelta(days=k % dates)  # as in a path
        rows.append(
            replace(done, arm=f"arm{k // dates}", date=day, verdict=verdict, key=f"copy{k}")
        )
    start = time.perf_counter()
    save_fleet(FleetDiagnosis("arm", tuple(rows), {}), folder / "fleet")
    found["statistics, table, page"] = time.perf_counter() - start
    found["page"] = (folder / "fleet" / "fleet.html").stat().st_size
    return found


def line(x: list[float], y: list[float]) -> tuple[float, float, float]:
    """Return offset and slope of the line through points, and the largest relative distance."""
    slope, offset = np.polyfit(x, y, 1)
    away = np.abs(offset + slope * np.array(x) - y) / y
    return float(offset), float(slope), float(away.max())


def main() -> None:
    """Measure lengths and rows, and print the slopes and what they give."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--rows", type=int, nargs="+", default=[5000, 10_000, 20_000])
    given.add_argument("--dates", type=int, default=100)
    given.add_argument("--of", type=int, default=100_000)
    given.add_argument("--one", type=Path, help="diagnose the recording of this folder, and end")
    asked = given.parse_args()
    if asked.one is not None:
        diagnose_one(asked.one)
        return
    print(f"load before: {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    with tempfile.TemporaryDirectory() as name:
        figures: list[list[float]] = []
        for seconds in SECONDS:
            folder = Path(name) / f"{seconds:g}"
            folder.mkdir()
            make(folder, 1, 1, seconds)
            command = [sys.executable, __file__, "--one", str(folder)]
            for _ in range(2):  # the first may compile
                done = subprocess.run(command, capture_output=True, text=True, check=True)
            figures.append(json.loads(done.stdout))
            took, peak, kept, size = figures[-1]
            print(
                f"{seconds:g} s, {size / 1e6:.2f} MB: CPU {took:.1f} s, "
                f"memory {peak / 1e9:.2f} GB, kept {kept / 1e6:.2f} MB"
            )
        cpu, memory, kept, size = (list(column) for column in zip(*figures, strict=True))
        many = asked.of
        offset, slope, off = line(list(SECONDS), cpu)
        hours = many * (offset + slope * USUAL) / 3600
        print(
            f"CPU: {offset:.1f} s + {1e3 * slope:.1f} ms/s (within {off:.0%}): "
            f"{hours:.0f} h of {many}"
        )
        offset, slope, off = line(size, memory)
        print(
            f"memory: {offset / 1e9:.2f} GB + {slope:.0f} B of each of the file (within {off:.0%})"
        )
        offset, slope, off = line(list(SECONDS), kept)
        room = many * (offset + slope * USUAL) / 1e9
        print(
            f"disk: {offset / 1e6:.2f} MB + {slope / 1e3:.2f} kB/s (within {off:.0%}): "
            f"{room:.0f} GB"
        )
        fleets = [fleet_of(Path(name) / f"{USUAL:g}", count, asked.dates) for count in asked.rows]
        for what in fleets[0]:
            measured = [fleet[what] for fleet in fleets]
            offset, slope, off = line([float(count) for count in asked.rows], measured)
            total = offset + slope * many
            unit = f"{1e3 * slope:.2f} ms a row (within {off:.0%}): {total / 60:.1f} min"
            if what == "page":
                unit = f"{slope:.0f} B a row (within {off:.0%}): {total / 1e6:.1f} MB"
            print(f"{what}: {unit} of {many}")
    print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
