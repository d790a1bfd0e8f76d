"""Run the tests: those that compute, a process for each core; beside them those that mostly wait.

    python tests/lanes/run.py             # what a change could break; `make test`
    python tests/lanes/run.py --all       # all; `make test-all`
    python tests/lanes/run.py --slow      # what the first leaves out; `make test-slow`

How each test ended is kept in `out/tests/`. Of `--all` and `--slow`, what has passed there is not
run again as long as no file of this checkout changes, so what was interrupted is called again and
goes on. At the end stand the longest tests, the time by folder, what failed, and how many passed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import subprocess
import sys
import time
from collections import Counter, defaultdict
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Final

from kept_results import LANES, Result, read

if TYPE_CHECKING:
    from collections.abc import Iterable

ROOT: Final = Path(__file__).resolve().parents[2]
KEPT: Final = ROOT / "out" / "tests"
SHOWN: Final = 15  # of the longest tests
DEPTH: Final = 3  # names of a folder in the table
MARKS: Final = {"fast": ["-m", "not slow"], "slow": ["-m", "slow"], "all": []}
NO_TESTS: Final = 5  # exit status of pytest


def version() -> str:
    """Return a digest of all files of this checkout but those that git ignores."""
    words = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    digest = hashlib.sha256()
    for name in sorted(set(listed.split("\0")[:-1])):
        path = ROOT / name
        content = path.read_bytes() if path.is_file() else b""
        digest.update(f"{name}\0{len(content)}\0".encode() + content)
    return digest.hexdigest()


def begin(which: str) -> Path:
    """Return the file of results: what passed there was of the same files."""
    results, kept_version = KEPT / f"{which}.jsonl", KEPT / f"{which}.version"
    KEPT.mkdir(parents=True, exist_ok=True)
    now = "" if which == "fast" else version()
    before = kept_version.read_text(encoding="utf-8") if kept_version.exists() else ""
    if now and now == before:
        done = sum(one.outcome == "passed" for one in read(results).values())
        print(f"{done} tests have passed with these files already; the others run")
    else:
        if which != "fast" and results.exists():
            print("files have changed since the last run: all tests run again")
        results.unlink(missing_ok=True)
        kept_version.write_text(now, encoding="utf-8")
    return results


def command(lane: str, marks: list[str], results: Path, workers: int) -> list[str]:
    """Return what runs a lane; of none of its tests is left what passed there before.

    Both lanes together have two processes for each core. With more, each takes the time to import
    and load the same again.
    """
    words = [sys.executable, "-m", "pytest", "--numprocesses", str(workers), "--dist", "loadfile"]
    return [*words, f"--lane={lane}", f"--results={results}", *marks]


def environment() -> dict[str, str]:
    """Return that of the tests.

    More threads of BLAS than idle cores wait for each other, and take three times as long.
    """
    return os.environ | {"OPENBLAS_NUM_THREADS": "1"}


def statuses_of(lanes: dict[str, list[str]]) -> list[int]:
    """Run lanes beside each other, the first in sight; return their exit statuses.

    What the others say is printed once the first has ended. One all of whose tests passed before
    ends well.
    """
    others = list(lanes)[1:]
    kept = {lane: KEPT / f"{lane}.log" for lane in others}
    with ExitStack() as stack:
        files = {lane: stack.enter_context(log.open("w")) for lane, log in kept.items()}
        running = [
            subprocess.Popen(
                words, cwd=ROOT, env=environment(), stdout=files.get(lane), stderr=files.get(lane)
            )
            for lane, words in lanes.items()
        ]
        statuses = [ended(running[0])]
        for lane, process in zip(others, running[1:], strict=True):
            statuses.append(ended(process))
            print(f"\n{lane} tests:\n{kept[lane].read_text(errors='replace')}")
    return [0 if status == NO_TESTS else status for status in statuses]


def ended(process: subprocess.Popen[bytes]) -> int:
    """Wait for a process that hears Ctrl-C as this one does, and ends by itself."""
    while True:
        try:
            return process.wait()
        except KeyboardInterrupt:
            continue


def table(results: Iterable[Result]) -> str:
    """Say what took how long, what failed, and how many passed."""
    results = list(results)
    folders: dict[str, list[Result]] = defaultdict(list)
    for one in results:
        parents = Path(one.test.partition("::")[0]).parent.parts
        folders["/".join(parents[:DEPTH])].append(one)
    longest = sorted(results, key=lambda one: -one.seconds)[:SHOWN]
    lines = ["", "    time     CPU  longest tests"]
    lines += [f"{one.seconds:6.1f} s{one.cpu:6.1f} s  {one.test}" for one in longest]
    lines += ["", "    time     CPU  tests  folder"]
    lines += [
        f"{_sum(of, 'seconds'):6.0f} s{_sum(of, 'cpu'):6.0f} s{len(of):7}  {name}"
        for name, of in sorted(folders.items(), key=lambda item: -_sum(item[1], "seconds"))
    ]
    failed = [f"FAILED {one.test}" for one in results if one.outcome == "failed"]
    return "\n".join([*lines, *([""] if failed else []), *failed])


def _sum(results: list[Result], name: str) -> float:
    return sum(getattr(one, name) for one in results)


def counted(results: Iterable[Result], seconds: float) -> str:
    """Say in a line how the tests ended, and how long that took."""
    ended = Counter(one.outcome for one in results)
    named = [name for name in ("failed", "passed", "skipped") if ended[name]]
    counts = ", ".join(f"{ended[name]} {name}" for name in named) or "no test"
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return f"{counts} in {seconds:.0f} s ({used.ru_utime + used.ru_stime:.0f} s of CPU)"


def main() -> int:
    """Run both lanes, also where tests of the first fail; fail where one does."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    given = parser.add_mutually_exclusive_group()
    for name in ("all", "slow"):
        given.add_argument(f"--{name}", dest="which", action="store_const", const=name)
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="0 for a debugger")
    parser.set_defaults(which="fast")
    options, more = parser.parse_known_args()
    results, before = begin(options.which), version() if options.which != "fast" else ""
    began = time.monotonic()
    lanes = {
        lane: [*command(lane, MARKS[options.which], results, options.workers), *more]
        for lane in LANES
    }
    # one after the other where somebody debugs
    groups = [lanes] if options.workers else [{lane: words} for lane, words in lanes.items()]
    statuses = [status for group in groups for status in statuses_of(group)]
    found = read(results).values()
    print(table(found), counted(found, time.monotonic() - began), sep="\n\n")
    if before and before != version():
        results.unlink()
        print("files changed meanwhile: what passed is of no one version, and runs again")
        return 1
    return next((status for status in statuses if status), 0)


if __name__ == "__main__":
    sys.exit(main())
