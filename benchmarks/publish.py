"""Run benchmarks, keep what they print, and write the figures of README and docs from that.

    python benchmarks/publish.py --list             # the runs, how long they take, what is kept
    python benchmarks/publish.py round_trip excite  # run these, then write the figures
    python benchmarks/publish.py                    # write the figures from what is kept
    python benchmarks/publish.py --check            # say what is not as the results have it

`published.yaml` has the commands of each run, and the figures: patterns that find them in what was
printed (`results/`). A run is refused where the tree differs from its last commit, since nobody
could repeat it. Where one takes hours, its scripts keep each case in `out/`, by the version: the
same call goes on where it was ended. How figures stand in a page: `figures.py`.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import shlex
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from figures import PAGES, RESULTS, ROOT, FigureError, Published, filled

# What no benchmark runs or reads: runs follow each other while pages are written.
_APART = (":!benchmarks/results", ":!README.md", ":!docs/*.md")


def version() -> str:
    """Return the name of the commit that the tree holds.

    Raises:
        FigureError: The tree differs from it.
    """
    changed = _git("status", "--porcelain", "--untracked-files=all", "--", ".", *_APART)
    if changed:
        raise FigureError(
            "the tree differs from its last commit, so that nobody could repeat the run; "
            f"commit these, or put them away:\n{changed}"
        )
    return _git("describe", "--always", "--tags", "--abbrev=8")


def run(name: str, commands: list[str]) -> None:
    """Run the commands of a benchmark and keep what they print, with what they ran on.

    Raises:
        FigureError: One failed, or the tree is another one afterwards; nothing is kept.
    """
    before, load, begin = version(), os.getloadavg()[0], time.monotonic()
    (ROOT / "out").mkdir(exist_ok=True)
    printed = "".join(f"$ {command}\n{_printed(command)}" for command in commands)
    minutes = (time.monotonic() - begin) / 60
    if version() != before:
        raise FigureError(f"{name}: another commit was checked out meanwhile; nothing is kept")
    head = (
        f"# {datetime.datetime.now(tz=datetime.UTC):%Y-%m-%d}, version {before}; {os.cpu_count()} "
        f"cores ({platform.machine()}), load {load:.1f}, {minutes:.1f} min\n"
    )
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.txt").write_text(head + _without_places(printed), encoding="utf-8")


def _printed(command: str) -> str:
    """Run a command as a reader would type it; show and return what it prints.

    One that misses its aim may end with status 1, and is kept as well.
    """
    program, *given = shlex.split(command)
    programs = {"python": sys.executable, "limo": str(Path(sys.executable).with_name("limo"))}
    lines: list[str] = []
    with (
        tempfile.TemporaryFile("w+", encoding="utf-8") as complained,
        subprocess.Popen(
            [programs[program], *given],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=complained,
            text=True,
        ) as process,
    ):
        for line in process.stdout or ():
            print(line, end="", flush=True)
            lines.append(line)
        status = process.wait()
        complained.seek(0)
        said = complained.read()
    if status not in (0, 1) or "Traceback (most recent call last)" in said:
        raise FigureError(f"{said}{command}: exit status {status}; nothing is kept")
    return "".join([*lines, "# exit status 1: an aim is missed\n"] if status else lines)


def _without_places(printed: str) -> str:
    """Leave out where the project and the recordings lie on this machine."""
    data = os.environ.get("LIMO_DATA")
    return (printed.replace(data, "$LIMO_DATA") if data else printed).replace(str(ROOT), ".")


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.rstrip()


def listed(published: Published) -> str:
    """Return a line for each run: how long it takes, and the day and version that are kept."""
    lines = []
    for name, given in published.runs.items():
        kept = RESULTS / f"{name}.txt"
        head = kept.read_text(encoding="utf-8").partition(";")[0][2:] if kept.exists() else "-"
        quiet = "quiet machine" if given.get("quiet") else ""
        lines.append(f"{name:24} {given['minutes']:4} min  {quiet:13}  {head}")
    return "\n".join(lines)


def main() -> int:
    """Run what is named, and write or check the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", help="runs of published.yaml, such as round_trip")
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--list", action="store_true", help="print the runs, and run nothing")
    asked = parser.parse_args()
    try:
        published = Published.load()
        unknown = [name for name in asked.names if name not in published.runs]
        if unknown:
            raise FigureError(f"no run of published.yaml: {', '.join(unknown)}; see --list")
        if asked.list:
            print(listed(published))
            return 0
        for name in asked.names:
            run(name, published.runs[name]["commands"])
        made = {path: filled(path, published) for path in PAGES}
    except FigureError as error:
        print(error, file=sys.stderr)
        return 1
    stale = [path for path, text in made.items() if path.read_text(encoding="utf-8") != text]
    if asked.check:
        for path in stale:
            print(f"{path} is out of date: run benchmarks/publish.py")
        return bool(stale)
    for path in stale:
        path.write_text(made[path], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
