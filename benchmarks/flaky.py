"""Which tests need luck: the fast lane again and again, each time in another order, beside loops.

    python benchmarks/flaky.py                            # three times, beside four busy loops
    python benchmarks/flaky.py --lane waiting --runs 30   # of what starts processes or sockets
    python benchmarks/flaky.py --runs 10 tests/backends/can

Loops are Python processes that count. Files are shuffled by the seed of a run, and so are the tests
of each. Every test that did not pass each time is listed with the seeds and with the log of
pytest. Runs are gathered in `out/flaky/` until there are as many as asked for, by selection and
version of the files of this checkout: what is interrupted goes on where it is called again.

The order is that of ten lines in `tests/lanes/kept_results.py`: pytest-randomly would also seed all
generators before each test, which hides what depends on them, and pytest-random-order has no tests
of its own order beside those of pytest-xdist.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Final

from clean_clones import ROOT, busy
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

sys.path.insert(0, str(ROOT / "tests" / "lanes"))
from kept_results import LANES, Result, read
from run import MARKS, NO_TESTS, command, environment, version

if TYPE_CHECKING:
    from pathlib import Path

KEPT: Final = ROOT / "out" / "flaky"
LOOK: Final = 0.5  # [s] between two looks at how far a run is


def one_run(lane: str, seed: int, folder: Path, options: argparse.Namespace) -> list[Result]:
    """Run the selected tests of a lane in an order, or what an interrupted run left of them."""
    results, log = (folder / f"{lane}-{seed}{end}" for end in (".jsonl", ".log"))
    done = results.with_suffix(".done")
    if not done.exists():
        words = command(lane, options.marks, results, options.workers)
        words += [f"--shuffle={seed}", "--no-loadscope-reorder", *options.tests]
        with busy(options.loops), log.open("a", encoding="utf-8") as said:
            ended = followed(words, said, results, f"{lane}, seed {seed}")
        if ended not in {0, 1, NO_TESTS}:
            raise SystemExit(f"flaky: pytest ended with status {ended}; see {log}")
        done.touch()
    return list(read(results).values())


def followed(words: list[str], said: object, results: Path, name: str) -> int:
    """Run a command, and show how many tests have ended; return its exit status."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    began = time.monotonic()
    with (
        Progress(
            *columns, TimeElapsedColumn(), console=console, disable=not console.is_terminal
        ) as bar,
        subprocess.Popen(
            words, cwd=ROOT, env=environment(), stdout=said, stderr=subprocess.STDOUT
        ) as process,
    ):
        task = bar.add_task(name, total=None)
        while process.poll() is None:
            time.sleep(LOOK)
            bar.update(task, completed=len(read(results)))
    counted = len(read(results))
    print(f"{name}: {counted} tests in {time.monotonic() - began:.0f} s", flush=True)
    return process.returncode


def table(runs: dict[tuple[str, int], list[Result]]) -> str:
    """List every test that did not pass each time, with the runs in which it failed."""
    failed: dict[str, list[str]] = defaultdict(list)
    for (lane, seed), results in runs.items():
        for one in results:
            if one.outcome == "failed":
                failed[one.test].append(f"{lane}-{seed}.log")
    lines = [
        f"{len(logs)} of {len(runs)}  {test}\n        {', '.join(logs)}"
        for test, logs in sorted(failed.items(), key=lambda item: -len(item[1]))
    ]
    return "\n".join(lines)


def selected(options: argparse.Namespace) -> Path:
    """Return the folder for the runs of this selection, of these files."""
    what = repr((options.marks, options.tests, options.loops)).encode()
    return KEPT / version()[:12] / hashlib.sha256(what).hexdigest()[:8]


def main() -> int:
    """Gather runs, and print what did not pass each time."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").splitlines()[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("tests", nargs="*", help="files or folders, instead of all")
    parser.add_argument("--runs", type=int, default=3, help="how many, those before included")
    parser.add_argument("--lane", choices=LANES, help="only tests that compute, or that wait")
    parser.add_argument("--slow", action="store_true", help="with what `make test` leaves out")
    parser.add_argument("--loops", type=int, default=4, help="busy ones beside each run")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="of the tests")
    options = parser.parse_args()
    if options.runs < 1 or options.loops < 0:
        parser.error("expected at least one run, and no fewer than 0 loops")
    options.marks = MARKS["all" if options.slow else "fast"]
    folder = selected(options)
    folder.mkdir(parents=True, exist_ok=True)
    print(f"runs are kept in {folder.relative_to(ROOT)}", flush=True)
    runs = {
        (lane, seed): one_run(lane, seed, folder, options)
        for seed in range(1, options.runs + 1)
        for lane in ([options.lane] if options.lane else LANES)
    }
    passed = min(sum(one.outcome == "passed" for one in results) for results in runs.values())
    found = table(runs)
    print(found or f"each of {len(runs)} runs passed whole; {passed} tests or more in each")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
