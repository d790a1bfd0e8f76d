"""Measured figures in pages that no result holds.

What counts as one: a number of a statement (a paragraph, a point of a list, a table with the
paragraph before it) that speaks of a measurement. In what is about figures alone (`ALL_OF`)
every statement does; elsewhere one that shows a sign of it: it names a benchmark, a day, a commit,
seeds or a bar, counts so many of so many, or tells microseconds, processor time, quantiles, errors,
or how many times better something is. No figures are: code, addresses, names with numbers in them,
what `publish.py` wrote, and statements that say why they are none: `<!-- not measured: WHY -->`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from figures import BLOCK, PRINT, SPAN

if TYPE_CHECKING:
    from collections.abc import Iterator

ALL_OF: Final = {  # page → the heading of what is about figures alone; of the whole page if empty
    "README.md": "How good, and what not",
    "benchmarks.md": "",
    "diagnosis_measured.md": "",
    "development_data.md": "",
}
# The page is made of the settings, which are chosen and not measured.
APART: Final = ("diagnosis_settings.md",)
_MONTHS = "January|February|March|April|May|June|July|August|September|October|November|December"
_SIGNS: Final = re.compile(
    rf"""benchmarks/\w+[\w/]*\.py|\b20\d\d-\d\d-\d\d\b|\b\d\d?\ (?:{_MONTHS})\b
    |`(?=[a-f]*\d)(?=\d*[a-f])[0-9a-f]{{7,8}}`|\bseeds?\ \d|\bbars?\b
    |\d\ of\ (?:the\ |all\ |its\ |their\ )?\d|\d\ µs|\[µs\]|\bp(?:50|99)\b
    |\b(?:processor|CPU|wall)\ time\b|\bload\ of\ \d|\bRMS\b|\bR?MSE\b|\bheld[ -]out\b|\breal\ [A-Z]
    |times\ (?:real\ time|better|worse|faster|slower|quicker|less|longer|as\ long)
    |\bmeasured\ (?:here|today|on\ (?:a|two|one))\b|\b(?:was|were|been)\ measured\b
    |\d\ %\ of\ the\ (?:errors|cases|pairs|joints|recordings|states)""",
    re.VERBOSE,
)
_NAMES: Final = re.compile(  # what has a number in it and tells none
    r"iiwa 14|ROS 2|MuJoCo [34]\b|from 3 to 4"
    r"|\(0 to 1\)|CiA 402|Med 7|\b95 % intervals?|intervals? of 95 %"
    r"|\b(?:[Jj]oints?|runs?) \d(?:(?:, | to | and | or )\d)*\b|\bseed \d+"
)
_NUMBER: Final = re.compile(r"(?<![\w.\-/])-?\d+(?:[ ]\d{3})*(?:\.\d+)?(?:e[-+]\d+)?(?![\w/])")
_FENCE: Final = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
_NO_PROSE: Final = re.compile(r"<!--.*?-->|`[^`\n]*`|\]\([^)]*\)|<[^>\n]*>", re.DOTALL)

_POINT: Final = r"^(?:[-*]|\d+\.) "


@dataclass(frozen=True)
class Unheld:
    """A statement with numbers that no result holds."""

    line: int
    numbers: tuple[str, ...]
    text: str

    def __str__(self) -> str:
        said = " ".join(self.text.split())
        return f"{self.line}: {', '.join(self.numbers)} in {said[:160]!r}"


def unheld(name: str, text: str) -> list[Unheld]:
    """Return the measured figures of a page that no result holds.

    Args:
        name: Of the page's file.
        text: Of the page.
    """
    if name in APART:
        return []
    strict = range(0)
    if name in ALL_OF:
        begin = text.index(f"## {ALL_OF[name]}\n") if ALL_OF[name] else 0
        strict = range(begin, len(text))
    text = re.sub(r"^#+ .*$", lambda match: " " * len(match[0]), text, flags=re.MULTILINE)
    for made in (SPAN, BLOCK, PRINT, _FENCE):
        text = made.sub(lambda match: "~" + re.sub(r"[^\n]", " ", match[0][1:]), text)
    found: list[Unheld] = []
    for start, statement in _statements(text):
        told = start in strict or _SIGNS.search(statement)
        if told and "<!-- not measured: " not in statement:
            prose = _NAMES.sub(" ", _NO_PROSE.sub(" ", statement))
            numbers = tuple(match[0] for match in _NUMBER.finditer(prose))
            if numbers:
                found.append(Unheld(text.count("\n", 0, start) + 1, numbers, statement))
    return found


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yield start and text of each paragraph and point; a table belongs to what is before it."""
    parts = [(m.start(), m[0]) for m in re.finditer(r"(?:[^\n]*\S[^\n]*\n?)+", text)]
    merged: list[tuple[int, str]] = []
    for start, part in parts:
        if merged and (part.startswith("|") or merged[-1][1].rstrip().endswith(":")):
            first, before = merged.pop()
            merged.append((first, before + "\n" + part))
        else:
            merged.append((start, part))
    for start, part in merged:
        points = [m.start() for m in re.finditer(_POINT, part, re.MULTILINE)]
        if points and part[: points[0]].rstrip().endswith(":"):
            points = []
        for begin, end in pairwise(sorted({0, *points, len(part)})):
            yield start + begin, part[begin:end]
