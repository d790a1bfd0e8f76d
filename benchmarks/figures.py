"""Figures in pages: each is found in what a benchmark printed, and links to that.

In a page, a figure of `published.yaml` stands in a sentence, or a table of them by itself:

    found in <!-- figure: load -->...<!-- end --> of all runs

    <!-- figures: diagnosis -->
    ...
    <!-- end of figures -->

    <!-- printed: table1 -->  (what was printed, or the part of it that the file's `prints` name)
    ...
    <!-- end of print -->

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

PRINT: Final = re.compile(
    r"(<!-- printed: (?P<name>\S+) -->\n).*?(<!-- end of print -->)", re.DOTALL
)


class FigureError(Exception):
    """A figure cannot be had; the message says which, and why."""


@dataclass(frozen=True)
class Published:
    """What is run, and which figures are taken from what it prints."""

    runs: dict[str, dict[str, Any]]  # commands, minutes and whether the machine has to be quiet
    tables: dict[str, list[dict[str, Any]]]  # rows: what, run, find, figure, aim, name
    prints: dict[str, dict[str, str]]  # run and, of a part, the pattern that finds it

    @classmethod
    def load(cls, path: Path = ROOT / "benchmarks" / "published.yaml") -> Published:
        """Read the file.

        Raises:
            FigureError: A row is of a run that there is not.
        """
        read = cls(**yaml.safe_load(path.read_text(encoding="utf-8")))
        rows = [*read.prints.values(), *(row for rows in read.tables.values() for row in rows)]
        for row in rows:
            if row["run"] not in read.runs:
                raise FigureError(f"{path.name}: no run {row['run']!r}, of which it has a figure")
        return read

    def figure(self, name: str, page: Path) -> str:
        """Return the figure of this name, as a link from a page to its result.

        Raises:
            FigureError: There is none of this name, or nothing is kept of its run.
        """
        rows = [row for rows in self.tables.values() for row in rows if row.get("name") == name]
        if len(rows) != 1:
            raise FigureError(f"{page.name}: {len(rows)} figures are named {name!r}, not one")
        result = _result(rows[0])
        if not result.exists():
            raise FigureError(f"{page.name}: figure {name!r} has no result. {_missing(rows)}")
        return f"[{_figure(rows[0], result)}]({_link(result, page)})"

    def table(self, name: str, page: Path) -> str:
        """Return the rows whose runs are kept, and say which others there are.

        Raises:
            FigureError: There is no such table.
        """
        if name not in self.tables:
            raise FigureError(f"{page.name}: published.yaml has no table {name!r}")
        kept = [row for row in self.tables[name] if _result(row).exists()]
        lines = [
            f"| {row['what']} | {_figure(row, _result(row))} | {row.get('aim', '')} "
            f"| {_when(_result(row), page)} |"
            for row in kept
        ]
        if lines:
            lines = ["| what | measured | aim | run |", "|---|---|---|---|", *lines]
        if len(kept) < len(self.tables[name]):
            lines += ["", _missing([row for row in self.tables[name] if row not in kept])]
        return "\n".join(lines).strip()

    def printed(self, name: str, page: Path) -> str:
        """Return what was printed, or how to run it.

        Raises:
            FigureError: There is no such print, or no such part.
        """
        if name not in self.prints:
            raise FigureError(f"{page.name}: published.yaml has no print {name!r}")
        row = self.prints[name]
        result = _result(row)
        if not result.exists():
            return _missing([row])
        text = result.read_text(encoding="utf-8").partition("\n")[2]
        if "find" in row:
            found = re.search(row["find"], text, re.MULTILINE | re.DOTALL)
            if not found:
                raise FigureError(f"{result.name} has nothing that fits {row['find']!r}")
            text = found[0]
        return f"```text\n{text.rstrip()}\n```\n{_when(result, page)}."


def filled(page: Path, published: Published) -> str:
    """Return the text of a page with its figures made anew.

    Raises:
        FigureError: A figure cannot be had.
    """
    text = page.read_text(encoding="utf-8")
    text = SPAN.sub(lambda m: f"{m[1]}{published.figure(m['name'], page)}{m[3]}", text)
    text = BLOCK.sub(lambda m: f"{m[1]}{published.table(m['name'], page)}\n{m[3]}", text)
    return PRINT.sub(lambda m: f"{m[1]}{published.printed(m['name'], page)}\n{m[3]}", text)


def _result(row: dict[str, Any]) -> Path:
    return RESULTS / f"{row['run']}.txt"


def _missing(rows: list[dict[str, Any]]) -> str:
    names = " ".join(dict.fromkeys(row["run"] for row in rows))
    return f"Not measured yet: `python benchmarks/publish.py {names}`."


def _when(result: Path, page: Path) -> str:
    """Return day and version of a result, as a link from a page."""
    head = result.read_text(encoding="utf-8").partition(";")[0].removeprefix("# ")
    return f"[{head}]({_link(result, page)})"


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


def _link(result: Path, page: Path) -> str:
    return os.path.relpath(result, page.parent)
