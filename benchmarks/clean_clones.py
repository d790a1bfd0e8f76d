"""`make demo`, `make test` and `.ci/run` as a stranger types them, over and over, quiet and busy.

    python benchmarks/clean_clones.py demo              # five quiet, five beside four busy loops
    python benchmarks/clean_clones.py test --quiet 1 --busy 5
    python benchmarks/clean_clones.py ci --quiet 1 --busy 0

Each run clones the last commit of this repository into an empty folder, without a `.venv` and with
nothing compiled, and calls it there, which installs first. What pip has downloaded before may
be used. Loops are Python processes that count; they are begun before a run and ended after it. The
table has the time of installation and of what comes after it, whether that passed (of the demo:
whether its page has all that it should), and what failed. Ten runs take an hour or two on two
cores.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Generator

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = {"demo": ["make", "demo"], "test": ["make", "test"], "ci": [".ci/run"]}
INSTALLED = {
    "demo": ".venv/.installed",
    "test": ".venv/.installed-dev",
    "ci": ".venv/.installed-dev",
}
MOST = {"demo": 360.0, "test": 300.0, "ci": 900.0}  # [s]; but for test, with the installation
FIGURES = 5  # of the page: errors, loops, two of the stream, the motion
CONCEALED = ("payload", "quadratic_drag")  # in the arm that is diagnosed
LAST_LINES = 25  # of a run that fails
_COUNTING = "while True: pass"
# set by whoever runs this, they would lead out of the clone, or to what was compiled elsewhere
_NOT_HANDED_ON = ("PYTHONPATH", "VIRTUAL_ENV", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME")


@dataclass(frozen=True)
class Run:
    """One `make` in a clone of its own."""

    loops: int  # beside it
    install: float  # [s]
    after: float  # [s] of what was made then
    failures: tuple[str, ...]  # none where it passed


def above_bar(target: str, one: Run) -> bool:
    """Say whether a quiet run took longer than promised."""
    took = one.after + (0.0 if target == "test" else one.install)
    return not one.loops and took > MOST[target]


@contextmanager
def busy(loops: int) -> Generator[None]:
    """Keep so many processes busy until the block ends."""
    processes = [subprocess.Popen([sys.executable, "-c", _COUNTING]) for _ in range(loops)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.wait()


def run(target: str, loops: int, folder: Path) -> Run:
    """Clone into a folder, and make a target there."""
    clone = folder / "limo"
    subprocess.run(["git", "clone", "--quiet", f"file://{ROOT}", str(clone)], check=True)
    environment = {k: v for k, v in os.environ.items() if k not in _NOT_HANDED_ON}
    environment["XDG_CACHE_HOME"] = str(
        folder / "cache"
    )  # of matplotlib and whoever else keeps one
    environment["PIP_CACHE_DIR"] = pip_cache()
    with busy(loops):
        log = folder / "make.log"
        install, installed = made(["make", INSTALLED[target]], clone, environment, log)
        after, good = made(COMMANDS[target], clone, environment, log) if installed else (0.0, False)
    failures = () if good else (f"it ended badly:\n{tail(log)}",)
    if target == "demo":
        failures += lacking(clone / "out" / "demo" / "index.html")
    return Run(loops, install, after, failures)


def made(
    words: list[str], clone: Path, environment: dict[str, str], log: Path
) -> tuple[float, bool]:
    """Run a command; return how long it took [s] and whether that went well."""
    began = time.monotonic()
    with log.open("a") as said:
        ended = subprocess.run(
            words,
            cwd=clone, env=environment, stdout=said, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
    return time.monotonic() - began, ended.returncode == 0


def lacking(page: Path) -> tuple[str, ...]:
    """Return what the demo's page should have and has not."""
    if not page.exists():
        return ("no page",)
    text = page.read_text()
    told = [f"part failed: {name}" for name in re.findall(r"<li>([^<]*)<pre>\$ ", text)]
    if len(re.findall("<figure", text)) < FIGURES or "missing, see above" in text:
        told.append("figures are missing")
    if not re.search(r"Contact was told on joints \d", text):
        told.append("the push was not told")
    verdict = page.parent / "diagnosis" / "verdict.json"
    findings = json.loads(verdict.read_text())["findings"] if verdict.exists() else []
    named = {item["effect"] for item in findings}
    unnamed = [effect for effect in CONCEALED if effect not in named]
    return (*told, *(f"the diagnosis does not name the {effect}" for effect in unnamed))


def pip_cache() -> str:
    """Return where pip keeps what it has downloaded."""
    command = [sys.executable, "-m", "pip", "cache", "dir"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def tail(log: Path) -> str:
    """Return the last lines of a log."""
    return "\n".join(log.read_text(errors="replace").splitlines()[-LAST_LINES:])


def main() -> None:
    """Run them all and print the table."""
    parser = argparse.ArgumentParser(
        description=(__doc__ or "").splitlines()[0],
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("target", choices=sorted(INSTALLED), help="what to make")
    parser.add_argument("--quiet", type=int, default=5, help="runs without busy loops")
    parser.add_argument("--busy", type=int, default=5, help="runs beside busy loops")
    parser.add_argument("--loops", type=int, default=4, help="busy loops beside each of those")
    parser.add_argument("--keep", action="store_true", help="keep the folders of all runs")
    given = parser.parse_args()
    if min(given.quiet, given.busy, given.loops) < 0 or given.quiet + given.busy == 0:
        parser.error("expected at least one run, quiet or busy, and no number below 0")
    loads = " ".join(f"{load:.1f}" for load in os.getloadavg())
    print(f"{os.cpu_count()} CPUs, load before {loads}; bars without busy loops: demo 360 s and ci "
          "900 s with their installation, test 300 s after it")  # fmt: skip
    print(f"run  busy loops  install [s]  {given.target} [s]  passed  what failed", flush=True)
    runs: list[Run] = []
    for loops in [0] * given.quiet + [given.loops] * given.busy:
        folder = Path(tempfile.mkdtemp(prefix=f"limo-{given.target}-"))
        try:
            runs.append(one := run(given.target, loops, folder))
        finally:
            if not given.keep:
                shutil.rmtree(folder, ignore_errors=True)
        verdict = "no" if one.failures else "yes"
        print(f"{len(runs):3d}  {loops:10d}  {one.install:11.0f}  {one.after:8.0f}  {verdict:6}  "
              f"{'; '.join(one.failures) or '-'}", flush=True)  # fmt: skip
        if given.keep:
            print(f"     kept in {folder}")
    slow = [one for one in runs if above_bar(given.target, one)]
    failed = sum(bool(one.failures) for one in runs)
    print(f"{len(runs) - failed} of {len(runs)} passed; {len(slow)} quiet ones above the bar")
    sys.exit(bool(failed or slow))


if __name__ == "__main__":
    main()
