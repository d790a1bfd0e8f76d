"""What Ray costs a fleet, and how two workers share its work, in processes and on Ray.

    python benchmarks/fleet/on_ray.py [--arms 4] [--dates 4] [--seconds 60] [--broken 300]

The recordings are those of `concealed_fleet.py`. Each run is `limo fleet diagnose` in a process of
its own, after one that has compiled what is compiled. CPU time is that of all its processes, those
of Ray's node included; beside other work on the machine it says more than the clock. Bars: results
are bitwise those of the pool; two workers take at most 1 / 0.9 of the CPU time of one, and by the
clock 1 / 1.8 of its time. What Ray adds to a recording is the time for each of many files that are
none, less that of the pool.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import psutil
import pyarrow.parquet as pq
from concealed_fleet import make

LOOK = 0.1  # [s] between two looks at the clocks of processes
LIMO = Path(sys.executable).with_name("limo")
_SUBREAPER = 36  # of `prctl`: orphans become children of this process, and their time is counted


@dataclass(frozen=True)
class Cost:
    """Time of a command and all that it started."""

    clock: float  # [s]
    cpu: float  # [s]


class Clocks:
    """CPU time of all processes below this one, as last seen: a node of Ray tells none."""

    def __init__(self) -> None:
        self._seen: dict[int, float] = {}  # [s] by process

    def look(self) -> None:
        """Read the clocks of what runs now."""
        for process in psutil.Process().children(recursive=True):
            with suppress(psutil.Error):
                times = process.cpu_times()
                self._seen[process.pid] = times.user + times.system

    def total(self) -> float:
        """Return the time of all [s]."""
        return sum(self._seen.values())


def measured(pattern: str, sim: Path, out: Path, workers: int, on: str) -> Cost:
    """Diagnose a fleet; its files may all be none, which ends the command with a status."""
    clocks, start = Clocks(), time.perf_counter()
    command = [LIMO, "fleet", "diagnose", pattern, "--sim", sim, "--out", out]
    given = [*command, "--workers", str(workers), "--on", on]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(given, **quiet) as process:
        while process.poll() is None:
            clocks.look()
            time.sleep(LOOK)
    clock = time.perf_counter() - start
    assert (out / "results.parquet").exists()
    return Cost(clock, clocks.total())


def same(one: Path, other: Path) -> bool:
    """Say whether two fleets have the same tables and files, but for how long each took."""
    tables = [pq.read_table(out / "results.parquet").drop(["seconds"]) for out in (one, other)]
    kept = [path.relative_to(one) for path in (one / "diagnoses").rglob("*.*")]
    files = [name for name in kept if name.name != "row.json"]
    assert files
    return tables[0].equals(tables[1]) and all(
        (one / name).read_bytes() == (other / name).read_bytes() for name in files
    )


def main() -> None:
    """Measure real recordings and files that are none, and print the figures beside the bars."""
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--arms", type=int, default=4)
    given.add_argument("--dates", type=int, default=4)
    given.add_argument("--seconds", type=float, default=60.0)
    given.add_argument("--broken", type=int, default=300)
    asked = given.parse_args()
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    print(f"load before: {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder, asked.arms, asked.dates, asked.seconds)
        pattern, sim = f"{folder}/recordings/**/*.parquet", folder / "sim.yaml"
        measured(f"{folder}/recordings/arm0/2026-03-01*", sim, folder / "warm", 1, "processes")
        cost: dict[tuple[str, int], Cost] = {}
        for on, workers in product(("processes", "ray"), (1, 2)):
            found = measured(pattern, sim, folder / f"{on}{workers}", workers, on)
            cost[on, workers] = found
            print(f"{on}, {workers} workers: {found.clock:.1f} s, CPU {found.cpu:.1f} s")
        for on in ("processes", "ray"):
            one, two = cost[on, 1], cost[on, 2]
            print(
                f"{on}: efficiency {one.cpu / two.cpu:.2f} by CPU (bar: 0.9), "
                f"{one.clock / two.clock / 2:.2f} by the clock (bar: 0.9)"
            )
        equal = same(folder / "processes2", folder / "ray2")
        print(f"bitwise equal: {equal} (bar: True)")
        broken = folder / "broken" / "arm"
        broken.mkdir(parents=True)
        for k in range(asked.broken):
            (broken / f"{k}.parquet").write_text(str(k))
        few, many = (folder / "broken/arm/?.parquet", folder / "broken/arm/*.parquet")
        for on in ("processes", "ray"):
            costs = [
                measured(str(files), sim, folder / f"broken-{on}-{k}", 1, on)
                for k, files in enumerate((few, many))
            ]
            more = asked.broken - 10
            clock, cpu = ((getattr(costs[1], s) - getattr(costs[0], s)) for s in ("clock", "cpu"))
            print(
                f"{on}: {1e3 * clock / more:.1f} ms a file that is none, CPU {1e3 * cpu / more:.1f}"
            )
    print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
