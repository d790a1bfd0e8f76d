"""Driver, service and watch for hours: the disk fills, the clock steps, the router dies.

    python benchmarks/service/long_run.py OUT --model model/ --hours 2
    python benchmarks/service/long_run.py OUT --model model/ --hours 0.1 --every 60 --rate 200
    python benchmarks/service/long_run.py OUT

`limo run --stream` moves an ideal arm in real time, `limo serve` answers, logs and retrains, `limo
watch` listens, each in a process of its own behind a router. Once in each period (`--every`) the
router is killed and comes back after ten seconds; in every second one a file fills the disk of the
logs for a minute, a tmpfs of the run's own mount namespace; in every third one the wall clock of
the processes steps by an hour, forward and back in turn, and their monotonic clock does not, by a
library that answers them in libc's stead. Each minute is a row of OUT/samples.csv, on the disk
before the next one; memory is what is a process's own, without files that it has mapped. What grows
has to do so in the second half of a run, too: before, caches fill and buffers come to their largest
size. Without --model, only what OUT holds is judged: so a run that was killed can be, too.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, suppress
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np
import psutil
from service_processes import (
    ARM,
    LIMO,
    Motion,
    configurations,
    describe_machine,
    running,
    save_trajectory,
    serve,
    two_versions,
)

from limo_driver.logs.mcap_log import log_files

PARTS = ("driver", "service", "watch")
ARRIVALS = ("received", "lost", "late", "duplicated", "restarts")
NAMES = {"memory": "memory [MB]", "handles": "handles", "threads": "threads"}
COUNTS = {
    "arrivals_received": "states received",
    "arrivals_lost": "states lost",
    "log_written": "messages logged",
    "log_dropped": "dropped while the disk was full",
    "files": "files of the log",
    "outages": "deaths of the router",
    "fillings": "times that the disk filled",
    "steps": "steps of the clock",
}
MEASURES = {"memory": 2.0, "handles": 1.0, "threads": 1.0}  # bars: MB, number and number an hour
LOST_BAR = 0.1  # % of the states, outside of outages
DOWN = 10.0  # [s] without a router
FULL = 0.1  # of a period without room
ROOM = "64M"  # of the disk of the logs
LOGS = "0.03"  # [GB] of logs, beyond which the oldest are deleted
HOUR = 3600.0
CLOCK = r"""
#define _GNU_SOURCE
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

static volatile long *ahead; /* [s] that the wall clock is set forward by */

__attribute__((constructor)) static void look(void) {
    int file = open(getenv("CLOCK_AHEAD"), O_RDONLY);
    ahead = mmap(NULL, sizeof *ahead, PROT_READ, MAP_SHARED, file, 0);
    close(file);
    if (ahead == MAP_FAILED) abort();
}
int clock_gettime(clockid_t clock, struct timespec *now) {
    int failed = syscall(SYS_clock_gettime, clock, now);
    int wall = clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE;
    if (!failed && wall && ahead) now->tv_sec += *ahead;
    return failed;
}
int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    *now = (struct timeval){t.tv_sec, t.tv_nsec / 1000};
    return 0;
}
time_t time(time_t *at) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (at) *at = t.tv_sec;
    return t.tv_sec;
}
"""
ROUTER = """
import sys, threading
from limo_driver.network.streaming import open_session

with open_session(config=sys.argv[1]):
    threading.Event().wait()
"""


class Status:
    """The newest status and all events that `limo watch --json` prints.

    Args:
        lines: What it prints.
        events: File for the events.
    """

    def __init__(self, lines: IO[bytes], events: Path) -> None:
        self.newest: dict[str, Any] = {}
        self.count = 0
        self._events = events.open("a", buffering=1)
        threading.Thread(target=self._read, args=(lines,), daemon=True).start()

    def _read(self, lines: IO[bytes]) -> None:
        for line in lines:
            heard = json.loads(line)
            if "status" in heard:
                self.newest, self.count = heard["status"], self.count + 1
            else:
                self._events.write(f"{line.decode().strip()}\n")


class World:
    """What happens to the processes: router, disk and clock.

    Args:
        folder: Where the disk of the logs is mounted, and the clock's offset is kept.
        config: Of the router.
    """

    def __init__(self, folder: Path, config: Path) -> None:
        self.disk, self._config = folder / "disk", config
        self.disk.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={ROOM}", "tmpfs", str(self.disk)]
        subprocess.run(mount, check=True)
        self._ballast = self.disk / "ballast"
        self._ahead = np.memmap(folder / "ahead", np.int64, "w+", shape=(1,))
        self.environment = os.environ | self._clock(folder)
        self.outages = self.fillings = self.steps = 0
        self._start_router()

    def _clock(self, folder: Path) -> dict[str, str]:
        """Compile what stands between the processes and the wall clock, and only that clock."""
        library = folder / "clock.so"
        command = ["cc", "-x", "c", "-", "-shared", "-fPIC", "-O2", "-o", str(library)]
        subprocess.run(command, input=CLOCK.encode(), check=True)
        return {"LD_PRELOAD": str(library), "CLOCK_AHEAD": str(folder / "ahead")}

    def _start_router(self) -> None:
        command = [sys.executable, "-c", ROUTER, str(self._config)]
        self.router = subprocess.Popen(bound(command), env=self.environment)

    def lose_router(self) -> None:
        """Kill it, and begin it anew after a while."""
        self.outages += 1
        self.router.kill()
        self.router.wait()
        time.sleep(DOWN)
        self._start_router()

    def end(self) -> None:
        """End what it began."""
        self.router.kill()

    def fill(self, seconds: float) -> None:
        """Leave no room on the disk of the logs for a while."""
        self.fillings += 1
        with suppress(OSError), self._ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:  # what retention frees is taken, too
            with suppress(OSError), self._ballast.open("ab", buffering=0) as file:
                file.write(bytes(4096))
            time.sleep(0.05)
        self._ballast.unlink()

    def figures(self) -> dict[str, Any]:
        """Return how its parts stand, and how often each thing happened."""
        logs = self.disk / "logs"
        return {
            "files": len(log_files(logs)) if logs.exists() else 0,
            "free": shutil.disk_usage(self.disk).free,
            **{name: getattr(self, name) for name in ("outages", "fillings", "steps")},
        }

    def step_clock(self) -> None:
        """Set the wall clock forward by an hour, or back."""
        self.steps += 1
        self._ahead[0] = 0 if self._ahead[0] else HOUR


def main() -> None:
    """Run, and judge what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of samples and logs; made, or judged")
    parser.add_argument("--model", type=Path, help="model folder of limo train")
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the states [Hz]")
    parser.add_argument("--every", type=float, default=600.0, help="one outage of the router [s]")
    parser.add_argument("--minute", type=float, default=60.0, help="between two samples [s]")
    given = parser.parse_args()
    samples = given.folder / "samples.csv"
    if given.model is None:
        judge(samples)
        return
    if "LIMO_MOUNTS" not in os.environ:  # the disk is mounted where nobody else sees it
        user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
        os.environ["LIMO_MOUNTS"] = "own"
        command = ["unshare", *user, "--mount", sys.executable, *sys.argv]
        os.execvp("unshare", command)  # noqa: S606  # no shell is needed
    given.folder.mkdir(parents=True)
    run(given, samples)
    judge(samples)
    print(describe_machine())


def run(given: argparse.Namespace, samples: Path) -> None:
    """Run everything, and write a row a minute, until the time is over or a process ends."""
    folder = given.folder.resolve()
    motion = Motion(given.model)
    store = two_versions(folder / "models", given.model, motion)
    save_trajectory(folder / "motion.traj.parquet", motion, store.robot, HOUR * given.hours + 120.0)
    here, there = configurations(folder, "router")
    world = World(folder, here)
    sim = str(given.model / "sim.yaml")
    driver = [*LIMO, "run", "--backend", "virtual", "--sim", sim, "--stream", "--name", ARM]
    driver += ["--trajectory", str(folder / "motion.traj.parquet"), "--json"]
    driver += ["--record", str(folder / "run.parquet"), "--rate", str(given.rate)]
    driver += ["--zenoh-config", str(there)]
    logs = world.disk / "logs"
    service = serve(there, "--store", str(store.root), "--log", str(logs), "--log-size", LOGS)
    watch = [*LIMO, "watch", "--arm", ARM, "--json", "--zenoh-config", str(there)]
    with ExitStack() as open_:
        out = [open_.enter_context((folder / f"{part}.txt").open("wb")) for part in PARTS[:2]]
        processes = [
            subprocess.Popen(bound(command), env=world.environment, stdout=to, stderr=to)
            for command, to in zip((driver, service), out, strict=True)
        ]
        processes.append(
            subprocess.Popen(bound(watch), env=world.environment, stdout=subprocess.PIPE)
        )
        open_.enter_context(running(started=processes))
        lines = processes[-1].stdout
        assert lines is not None
        status = Status(lines, folder / "events.jsonl")
        open_.callback(world.end)
        threading.Thread(target=trouble, args=(world, given.every), daemon=True).start()
        watch_over(given, samples, world, dict(zip(PARTS, processes, strict=True)), status)


def trouble(world: World, every: float) -> None:
    """Let everything happen, one after the other, period after period."""
    plan = (  # when in a period, in every how many of them
        (0.3, 3, world.step_clock),
        (0.5, 1, world.lose_router),
        (0.7, 2, lambda: world.fill(FULL * every)),
    )
    began = time.monotonic()
    for number in count():
        for part, due, happens in plan:
            time.sleep(max(0.0, began + (number + part) * every - time.monotonic()))
            if number % due == 0:
                happens()


def watch_over(
    given: argparse.Namespace,
    samples: Path,
    world: World,
    processes: dict[str, subprocess.Popen[bytes]],
    status: Status,
) -> None:
    """Write a row a minute, until the time is over or a process ends."""
    seen = {part: psutil.Process(process.pid) for part, process in processes.items()}
    began = time.monotonic()
    with samples.open("w", newline="") as file:
        for k in range(1, round(HOUR * given.hours / given.minute) + 1):
            time.sleep(max(0.0, began + k * given.minute - time.monotonic()))
            minutes = round((time.monotonic() - began) / 60.0, 3)
            for part, process in processes.items():
                if (ended := process.poll()) is not None:
                    print(f"{part} ended with exit status {ended} after {minutes} minutes")
                    return
            row: dict[str, Any] = {"minutes": minutes}
            for part, process in seen.items():
                row |= {f"{part}_{name}": value for name, value in look(process).items()}
            row |= heard(status) | world.figures()
            row |= {"rate": given.rate, "load": os.getloadavg()[0]}
            table = csv.DictWriter(file, row)
            if k == 1:
                table.writeheader()
            table.writerow(row)
            file.flush()
            os.fsync(file.fileno())


def heard(status: Status) -> dict[str, Any]:
    """Return what the service says of itself."""
    arrivals, log = (status.newest.get(name, {}) for name in ("arrivals", "log"))
    return {
        **{f"arrivals_{name}": arrivals.get(name) for name in ARRIVALS},
        **{f"log_{name}": log.get(name) for name in ("written", "dropped")},
        "statuses": status.count,
    }


def look(process: psutil.Process) -> dict[str, float]:
    """Return what a process holds and has used."""
    with process.oneshot():
        memory = process.memory_info()
        return {
            "memory": (memory.rss - memory.shared) / 1e6,
            "handles": process.num_fds(),
            "threads": process.num_threads(),
            "cpu": sum(process.cpu_times()[:2]),
        }


def bound(command: list[str]) -> list[str]:
    """Return a command whose process ends with this one, however this one ends."""
    return ["setpriv", "--pdeathsig", "TERM", *command]


def judge(samples: Path) -> None:
    """Print what was seen by the hour, how it grew, and the verdict."""
    with samples.open() as file:
        rows = list(csv.DictReader(file))
    if not rows:
        sys.exit(f"{samples} has no rows: the run ended within its first minute")
    columns = {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}
    minutes = columns["minutes"]
    hours, counted = minutes / 60.0, minutes > minutes[-1] / 2
    ends = [np.flatnonzero(hours // 1 == h)[-1] for h in np.unique(hours // 1)]
    load = columns["load"].mean()
    print(f"{minutes[-1]:.0f} min at {columns['rate'][0]:g} Hz, load {load:.1f} on average")
    show("at the end, minute", minutes[ends], "an hour", "bar")
    failed: list[str] = []
    for part in PARTS:
        for name, bar in MEASURES.items():
            values, label = columns[f"{part}_{name}"], f"{part} {NAMES[name]}"
            slope, error = trend(hours[counted], values[counted])
            show(label, values[ends], f"{slope:+.2f} ± {error:.2f}", f"{bar:g}")
            failed += [label] if slope - 2.0 * error > bar else []
        used = np.diff(columns[f"{part}_cpu"][[0, -1]]) / np.diff(minutes[[0, -1]]) / 0.6
        show(f"{part} processor [% of one]", used)
    show("lost while the router lives [%]", np.array([losses(columns)]), "", f"{LOST_BAR:g}")
    failed += ["losses"] if losses(columns) > LOST_BAR else []
    for name, what in COUNTS.items():
        show(what, columns[name][ends])
    print("verdict: " + (f"grows or loses: {', '.join(failed)}" if failed else "flat"))


def show(label: str, values: np.ndarray, slope: str = "", bar: str = "") -> None:
    """Print a row of the table."""
    cells = "".join(f"{value:10.1f}" if value % 1 else f"{value:10.0f}" for value in values)
    print(f"{label:36}{cells}{slope:>20}{bar:>6}")


def trend(hours: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Return the slope of a straight line through values, and its standard error."""
    if hours.size < 3:
        return np.nan, np.nan
    away = hours - hours.mean()
    slope = away @ values / (away @ away)
    left = values - values.mean() - slope * away
    return slope, float(np.sqrt(left @ left / (hours.size - 2) / (away @ away)))


def losses(columns: dict[str, np.ndarray]) -> float:
    """Return the share of states that was lost in minutes without an outage [%]."""
    calm = np.diff(columns["outages"]) == 0
    calm[1:] &= calm[:-1]  # it comes back in the minute after
    lost, came = (np.diff(columns[f"arrivals_{name}"])[calm].sum() for name in ("lost", "received"))
    return 100.0 * lost / max(lost + came, 1.0)


if __name__ == "__main__":
    main()
