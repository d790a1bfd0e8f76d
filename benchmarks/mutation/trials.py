"""Trials: tests run on a changed copy of this tree, in a process that is forked for each.

A trial ends at its first failure, in a limit of processor time that a busy machine does not use
up, or in one of memory. What is no part of this tree is imported once, before the fork.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Final, NoReturn

if TYPE_CHECKING:
    from collections.abc import Generator, Mapping, Sequence

    from mutation.changes import Mutant

ROOT: Final = Path(__file__).resolve().parents[2]
LANES: Final = {"fast": "not slow", "slow": "slow"}
OFTEN: Final = 10.0  # times the processor time of the tests of what is unchanged
LEAST: Final = 120.0  # [s] of processor time: a loop without an end is noticed, too
LONGEST: Final = 1200.0  # [s] beside that, for what waits for ever
MEMORY: Final = 8 << 30  # [byte]
NO_TESTS: Final = 5  # what pytest ends with
FORKS: Final = multiprocessing.get_context("forkserver")
PRELOADED: Final = (
    "__main__", "hypothesis", "mujoco", "numba", "pinocchio", "pyarrow.parquet", "pytest",
    "scipy.interpolate", "scipy.ndimage", "scipy.signal", "scipy.stats", "typer.testing", "yaml",
)  # fmt: skip


@dataclass(frozen=True)
class Tests:
    """Tests that should notice a change of one file.

    Args:
        paths: Of them, or of folders.
        lane: Of `LANES`.
        compiled: Whether numba compiles; else compiled functions run as plain Python, which is
            faster where little is computed.
    """

    paths: tuple[str, ...]
    lane: str
    compiled: bool


@dataclass(frozen=True)
class Outcome:
    """What came of a trial."""

    noticed: bool
    seconds: float
    told: str  # the last of what the tests printed


def copy_of_tree(folder: Path) -> Path:
    """Copy what git knows, and what is new and not ignored."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    for name in filter(None, listed.split("\0")):
        if (ROOT / name).is_file() and not (ROOT / name).is_symlink():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder


class Trees:
    """Copies of this tree, each of which holds one change at a time."""

    def __init__(self, folder: Path, count: int) -> None:
        self._free: SimpleQueue[Path] = SimpleQueue()
        first = copy_of_tree(folder / "0")
        subprocess.run([sys.executable, "-m", "compileall", "-q", str(first)], check=False)
        self._free.put(first)
        for k in range(1, count):
            self._free.put(Path(shutil.copytree(first, folder / str(k))))

    def run(self, tests: Tests, mutant: Mutant | None = None, usual: float = 0.0) -> Outcome:
        """Run tests in a tree that is free, with a change or none.

        Args:
            tests: To be run.
            mutant: The change.
            usual: What they take without one [s].
        """
        with self._one() as tree, _changed(tree, mutant):
            return _run(tree, tests, LEAST + OFTEN * usual)

    @contextmanager
    def _one(self) -> Generator[Path]:
        tree = self._free.get()
        try:
            yield tree
        finally:
            self._free.put(tree)


@contextmanager
def _changed(tree: Path, mutant: Mutant | None) -> Generator[None]:
    if mutant is None:
        yield
        return
    path = tree / mutant.file
    source = path.read_text()
    path.write_text(source[: mutant.start] + mutant.instead + source[mutant.stop :])
    try:
        yield
    finally:
        path.write_text(source)


def _run(tree: Path, tests: Tests, limit: float) -> Outcome:
    printed, begin = tree.with_suffix(".txt"), time.monotonic()
    process = FORKS.Process(target=run_tests, args=(tree, tests, limit, printed))
    process.start()
    process.join(limit + LONGEST)
    with suppress(ProcessLookupError):  # what it started goes with it
        os.killpg(process.pid or 0, signal.SIGKILL)
    process.join()
    told = printed.read_text(errors="replace")[-2000:] if printed.exists() else ""
    return Outcome(process.exitcode not in {0, NO_TESTS}, time.monotonic() - begin, told)


def run_tests(tree: Path, tests: Tests, limit: float, printed: Path) -> NoReturn:
    """Run tests in this process, and end it."""
    os.setsid()
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit)))
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    target = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(target, stream)
    os.chdir(tree)
    sys.path.insert(0, str(tree))
    os.environ["PYTHONPATH"] = str(tree)  # of the programs that tests start
    # Bytecode is told from a change by its time; of two changes in a second it would be the same.
    sys.dont_write_bytecode = True
    if not tests.compiled:
        _switch_numba_off()
    import pytest

    quick = ("-x", "-q", "--tb=line", "-p", "no:cacheprovider", "-p", "no:xdist", "--assert=plain")
    sys.exit(pytest.main([*quick, "-m", LANES[tests.lane], *tests.paths]))


def _switch_numba_off() -> None:
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    import numba

    numba.config.DISABLE_JIT = 1


def start(machine_code: Path) -> None:
    """Have what all trials share imported once, and machine code kept over trees and runs."""
    os.environ["NUMBA_CACHE_DIR"] = str(machine_code)
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    FORKS.set_forkserver_preload(list(PRELOADED))


def files_of(paths: Sequence[str]) -> list[Path]:
    """Return the files of tests, those of folders included."""
    found = [ROOT / path.partition("::")[0] for path in paths]
    return [file for path in found for file in (sorted(path.rglob("test_*.py")) or [path])]


@dataclass(frozen=True)
class _Known:
    noticed: bool = False
    tests: Mapping[str, str] = field(default_factory=dict[str, str])  # that ran, and their digests


class Kept:
    """Outcomes of trials: what was noticed stays so, and tests that did not notice need not run.

    Args:
        path: Of the file, which grows by a line for each trial.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._known = path, dict[tuple[str, str, str], _Known]()
        self._one_at_a_time = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        for line in path.read_text().splitlines() if path.exists() else ():
            entry = json.loads(line)
            self._take((entry["file"], entry["name"], entry["lane"]), entry)

    def noticed(self, mutant: Mutant, lane: str) -> bool:
        """Say whether tests of a lane are known to notice a mutant."""
        return self._of(mutant, lane).noticed

    def lives(self, mutant: Mutant, lane: str) -> bool:
        """Say whether a mutant was tried, and not noticed."""
        known = self._of(mutant, lane)
        return bool(known.tests) and not known.noticed

    def untried(self, mutant: Mutant, tests: Tests) -> Tests:
        """Return those of some tests that did not run on a mutant yet, as they are now."""
        known = self._of(mutant, tests.lane)
        files = [str(file.relative_to(ROOT)) for file in files_of(tests.paths)]
        new = [file for file in files if known.tests.get(file) != digest(file)]
        return replace(tests, paths=() if known.noticed else tuple(dict.fromkeys(new)))

    def add(self, mutant: Mutant, tests: Tests, outcome: Outcome) -> None:
        """Keep what came of a trial."""
        key = {"file": mutant.file, "name": mutant.name, "lane": tests.lane}
        entry = {"noticed": outcome.noticed, "seconds": round(outcome.seconds, 1)}
        entry["tests"] = {file: digest(file) for file in tests.paths}
        with self._one_at_a_time, self._path.open("a") as file:
            file.write(json.dumps(key | entry) + "\n")
            self._take((mutant.file, mutant.name, tests.lane), entry)

    def _of(self, mutant: Mutant, lane: str) -> _Known:
        return self._known.get((mutant.file, mutant.name, lane), _Known())

    def _take(self, key: tuple[str, str, str], entry: Mapping[str, bool | dict[str, str]]) -> None:
        before = self._known.get(key, _Known())
        tests = {**before.tests, **entry["tests"]}
        self._known[key] = _Known(before.noticed or bool(entry["noticed"]), tests)


@cache  # tests that change while a run goes on are no part of it
def digest(file: str) -> str:
    """Return what tells a file of tests from what it was."""
    return hashlib.sha256((ROOT / file).read_bytes()).hexdigest()[:16]
