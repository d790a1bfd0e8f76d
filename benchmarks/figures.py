"""Figures in pages: each is found in what a benchmark printed, and links to that.

In a page, a figure of `published.yaml` stands in a sentence, or a table of them by itself:

    found in <!-- figure: load -->...<!-- end --> of all runs

    <!-- figures: diagnosis -->
    ...
    <!-- end of figures -->

What is between the marks is written by `publish.py`. Whatever else a page says was measured is
found by `unheld`, which the tests hold to nothing.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "benchmarks" / "results"
PAGES: Final = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
SPAN: Final = re.compile(r"(<!-- figure: (?P<name>\S+) -->).*?(<!-- end -->)", re.DOTALL)
BLOCK: Final = re.compile(
    r"(<!-- figures: (?P<name>\S+) -->\n).*?(<!-- end of figures -->)", re.DOTALL
)


class FigureError(Exception):
    """A figure cannot be had; the message says which, and why."""


@dataclass(frozen=True)
class Published:
    """What is run, and which figures are taken from what it prints."""

    runs: dict[str, dict[str, Any]]  # commands, minutes and whether the machine has to be quiet
    tables: dict[str, list[dict[str, Any]]]  # rows: what, run, find, figure, aim, name

    @classmethod
    def load(cls, path: Path = ROOT / "benchmarks" / "published.yaml") -> Published:
        """Read the file.

        Raises:
            FigureError: A row is of a run that there is not.
        """
        read = yaml.safe_load(path.read_text(encoding="utf-8"))
        for table, rows in read["tables"].items():
            for row in rows:
                if row["run"] not in read["runs"]:
                    raise FigureError(f"{path.name}: {table} has a row of no run: {row['run']!r}")
        return cls(read["runs"], read["tables"])

    def figure(self, name: str, page: Path) -> str:
        """Return the figure of this name, as a link from a page to its result.

        Raises:
            FigureError: There is none of this name, or nothing is kept of its run.
        """
        rows = [row for rows in self.tables.values() for row in rows if row.get("name") == name]
        if len(rows) != 1:
            raise FigureError(f"{page.name}: {len(rows)} figures are named {name!r}, not one")
        result = RESULTS / f"{rows[0]['run']}.txt"
        if not result.exists():
            raise FigureError(
                f"{page.name}: nothing is kept of {name!r}; run it by "
                f"python benchmarks/publish.py {rows[0]['run']}"
            )
        return f"[{_figure(rows[0], result)}]({_link(result, page)})"

    def table(self, name: str, page: Path) -> str:
        """Return the rows whose runs are kept, and say which others there are.

        Raises:
            FigureError: There is no such table.
        """
        if name not in self.tables:
            raise FigureError(f"{page.name}: published.yaml has no table {name!r}")
        lines, missing = [], []
        for row in self.tables[name]:
            result = RESULTS / f"{row['run']}.txt"
            if not result.exists():
                missing.append(row["run"])
                continue
            when = f"[{_head(result)}]({_link(result, page)})"
            lines.append(
                f"| {row['what']} | {_figure(row, result)} | {row.get('aim', '')} | {when} |"
            )
        if lines:
            lines = ["| what | measured | aim | run |", "|---|---|---|---|", *lines]
        if missing:
            names = " ".join(dict.fromkeys(missing))
            lines += ["", f"Not measured yet: `python benchmarks/publish.py {names}`."]
        return "\n".join(lines).strip()


def filled(page: Path, published: Published) -> str:
    """Return the text of a page with its figures made anew.

    Raises:
        FigureError: A figure cannot be had.
    """
    text = page.read_text(encoding="utf-8")
    text = SPAN.sub(lambda m: f"{m[1]}{published.figure(m['name'], page)}{m[3]}", text)
    return BLOCK.sub(lambda m: f"{m[1]}{published.table(m['name'], page)}\n{m[3]}", text)


def _figure(row: dict[str, Any], result: Path) -> str:
    _, _, printed = result.read_text(encoding="utf-8").partition("\n")
    return row["figure"].format(
        **{key: _found(pattern, printed, result) for key, pattern in row["find"].items()}
    )


def _found(pattern: str, printed: str, result: Path) -> str:
    """Return what a pattern finds; of several numbers, the lowest and the highest."""
    found = list(dict.fromkeys(re.findall(pattern, printed, re.MULTILINE)))
    if not found:
        raise FigureError(f"{result.name} has nothing that fits {pattern!r}")
    if len(found) == 1:
        return found[0]
    order = sorted(found, key=lambda text: float(re.sub(r"[^\d.eE+-]", "", text)))
    return f"{order[0]} to {order[-1]}"


def _head(result: Path) -> str:
    """Return day and version of a result."""
    return result.read_text(encoding="utf-8").partition(";")[0].removeprefix("# ")


def _link(result: Path, page: Path) -> str:
    return os.path.relpath(result, page.parent)
