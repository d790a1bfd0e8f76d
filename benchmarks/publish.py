"""Run benchmarks, keep what they print, and write the page of figures from it.

    python benchmarks/publish.py exports/round_trip excite   # run these, then write the page
    python benchmarks/publish.py                             # write the page from what is kept
    python benchmarks/publish.py --check                     # say whether the page is up to date

`published.yaml` says which figures the page shows: for each, the script, and patterns that find the
figure in what the script printed (`results/`). Nobody copies a figure, so none can be out of date
unnoticed. What takes hours or needs another machine is entered by hand, and the page says so.
"""

from __future__ import annotations

import argparse
import datetime
import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).parent
ROOT = HERE.parent
RESULTS = HERE / "results"
PAGE = ROOT / "docs" / "benchmarks.md"
BEGIN, END = "<!-- figures: made by benchmarks/publish.py -->", "<!-- end of figures -->"


def run(name: str, arguments: list[str]) -> None:
    """Run a benchmark and keep what it printed, with what it ran on.

    Raises:
        SystemExit: It failed; nothing is kept.
    """
    command = ["benchmarks/" + name + ".py", *arguments]
    load, begin = os.getloadavg()[0], time.monotonic()
    done = subprocess.run(
        [sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{name}: exit status {done.returncode}\n{done.stdout}{done.stderr}")
    seconds = time.monotonic() - begin
    version = _git("describe", "--always", "--dirty")
    head = (
        f"$ python {' '.join(command)}\n"
        f"# {datetime.datetime.now(tz=datetime.UTC):%Y-%m-%d}, version {version}; "
        f"{os.cpu_count()} cores ({platform.machine()}), load {load:.1f}, {seconds:.0f} s\n"
    )
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / (name.replace("/", "_") + ".txt")
    path.write_text(head + done.stdout.replace(str(ROOT), "."), encoding="utf-8")


def page(text: str) -> str:
    """Return the page with its figures made anew."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{_tables()}\n{END}{after}"


def _tables() -> str:
    wanted = yaml.safe_load((HERE / "published.yaml").read_text(encoding="utf-8"))
    parts = [f"## {group['title']}\n\n{_table(group['rows'])}" for group in wanted]
    return "\n\n".join(parts)


def _table(rows: list[dict[str, Any]]) -> str:
    lines = ["| what | measured | aim | by |", "|---|---|---|---|"]
    for row in rows:
        figure, when = _figure(row)
        script = f"[`{row['script'].split('/')[-1]}.py`](../benchmarks/{row['script']}.py)"
        lines.append(f"| {row['what']} | {figure} | {row.get('aim', '')} | {script}, {when} |")
    return "\n".join(lines)


def _figure(row: dict[str, Any]) -> tuple[str, str]:
    """Return a figure and when it was measured."""
    if "find" not in row:
        return row["figure"], row["when"]
    name = row["script"].replace("/", "_")
    path = RESULTS / f"{name}.txt"
    _, _, printed = path.read_text(encoding="utf-8").partition("\n#")
    known = {key: _found(pattern, printed, name) for key, pattern in row["find"].items()}
    day = printed.split(",")[0].strip()
    return row["figure"].format(**known), f"[{day}](../benchmarks/results/{path.name})"


def _found(pattern: str, printed: str, name: str) -> str:
    """Return what a pattern finds; of several numbers, the lowest and the highest.

    Raises:
        SystemExit: It finds nothing.
    """
    found = list(dict.fromkeys(re.findall(pattern, printed, re.MULTILINE)))
    if not found:
        raise SystemExit(f"results of {name} have nothing that fits {pattern!r}")
    if len(found) == 1:
        return found[0]
    order = sorted(found, key=lambda text: float(re.sub(r"[^\d.eE+-]", "", text)))
    return f"{order[0]} to {order[-1]}"


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def main() -> int:
    """Run what is named, and write or check the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("names", nargs="*", help="benchmarks to run, such as exports/round_trip")
    parser.add_argument("--check", action="store_true", help="write nothing")
    asked = parser.parse_args()
    options = {
        row["script"]: row.get("arguments", [])
        for group in yaml.safe_load((HERE / "published.yaml").read_text(encoding="utf-8"))
        for row in group["rows"]
        if "find" in row
    }
    for name in asked.names:
        run(name, options.get(name, []))
    text = PAGE.read_text(encoding="utf-8")
    made = page(text)
    if asked.check:
        print("up to date" if made == text else f"{PAGE} is out of date: run benchmarks/publish.py")
        return int(made != text)
    PAGE.write_text(made, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
