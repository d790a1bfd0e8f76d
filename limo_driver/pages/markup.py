"""Pieces of HTML: texts, tables and the places of charts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import floor, isfinite
from typing import Any, Final, TypeAlias

from limo_driver.quoting import in_html as escape
from limo_driver.quoting import in_line

Figure: TypeAlias = dict[str, Any]  # of plotly: data, layout, and how many rows it has, if any

UNSAID = "\N{EN DASH}"  # a figure that is not known
_NBSP = "\N{NO-BREAK SPACE}"
# A number and its unit, a unit of several words, an interval: none of them is broken into lines.
_WHOLE = re.compile(
    r"(?<=\d) (?:N m|N|kg|g|rad|mm|m|s|min|Hz|%)(?!\w)|\bN m\b(?: s)?|\[[^\]\s]+, [^\]\s]+\]"
)
_PERCENT = re.compile(r"(?<=\d)%")  # no space before it, which SI wants
# People after whom laws are named; identifiers write them small.
_PEOPLE = re.compile(r"\b(?:coulomb|stribeck|dahl|maxwell|preisach)\b(?!-)")
_CODE = re.compile(r"`([^`]+)`")
_HIGH: Final = 280  # [px], of a chart
_AXIS, _ROW = 90, 30  # [px], of a chart with rows: its axis and legend, and each row
_LONG = 110  # characters of a title that is set smaller, so that it keeps to two lines
_NEARLY_ALL, _HARDLY_ANY = 0.985, 0.005


@dataclass
class Charts:
    """The charts of a page, in the order in which it refers to them."""

    figures: list[Figure] = field(default_factory=list)

    def place(self, figure: Figure, caption: str, note: str = "", *, follows: bool = False) -> str:
        """Add a chart and return its place in the page.

        Args:
            figure: What is drawn.
            caption: What it shows, also for who cannot see it.
            note: Beside the caption, in small letters.
            follows: Whether its x is the time of the motion that the arm of the page plays.
        """
        self.figures.append(figure)
        cursor = " data-cursor" if follows else ""
        high = _AXIS + _ROW * figure["rows"] if "rows" in figure else _HIGH
        small = f" <small>{escape(note)}</small>" if note else ""
        heading = f"<figcaption>{escape(caption)}{small}</figcaption>"
        return (
            f'<figure>{heading}<div class="chart"{cursor} role="img" '
            f'aria-label="{escape(caption)}" '
            f'data-figure="{len(self.figures) - 1}" style="height:{high}px"></div>'
            "</figure>"
        )

    def as_json(self) -> str:
        """Return all charts as JSON that may stand inside a script element."""
        content: list[dict[str, Any]] = [
            {"data": _inert(item["data"]), "layout": _inert(item["layout"])}
            for item in self.figures
        ]
        return script_json(content)


def _inert(value: Any, key: str = "") -> Any:  # noqa: ANN401  # values of plotly
    """Return values of a chart in whose texts plotly finds no tags, but in those of limo's own."""
    if isinstance(value, str):
        if key == "hovertemplate":
            return value
        return in_line(_with_people(value)).replace("&", "&amp;").replace("<", "&lt;")
    if isinstance(value, dict):
        return {name: _inert(item, name) for name, item in value.items()}
    if isinstance(value, list) and any(isinstance(item, (str, dict, list)) for item in value):
        return [_inert(item, key) for item in value]
    return value


def script_json(value: object) -> str:
    """Return values as JSON that may stand inside a script element."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c")


def section(title: str, body: str, anchor: str, lead: str = "") -> str:
    """Return a section with a heading; empty if it has no content."""
    if not body:
        return ""
    intro = paragraph(lead, "lead") if lead else ""
    return f'<section id="{anchor}"><h2>{escape(title)}</h2>{intro}{body}</section>'


def header(crumb: str, title: str, *sources: str, badge: tuple[str, str] | None = None) -> str:
    """Return the head of a page.

    Args:
        crumb: What kind of page it is, and of what.
        title: The result in one sentence, with values and units.
        sources: What it was computed from, a paragraph each.
        badge: The result in a word or two, and its class in style.css.
    """
    said = "".join(paragraph(text, "sources") for text in sources if text)
    size = ' class="long"' if len(title) > _LONG else ""
    mark = f'<p><span class="badge {badge[1]}">{escape(badge[0])}</span></p>' if badge else ""
    return (
        f'<header{size}><p class="crumb">{escape(crumb)}</p>{mark}'
        f"<h1>{escape(typeset(title))}</h1>{said}</header>"
    )


def typeset(text: str) -> str:
    """Return a text whose numbers stay beside their units, and intervals and units whole."""
    spaced = _PERCENT.sub(" %", _with_people(text))
    kept = _WHOLE.sub(lambda whole: whole[0].replace(" ", _NBSP), spaced)
    return kept.replace("^2", "\N{SUPERSCRIPT TWO}")


def _with_people(text: str) -> str:
    return _PEOPLE.sub(lambda name: name[0].capitalize(), text)


def prose(text: str) -> str:
    """Return a text as HTML: typeset, and what stands in backticks as code."""
    return _CODE.sub(r"<code>\1</code>", escape(typeset(text)))


def listed(items: Iterable[str]) -> str:
    """Return texts as a list; empty if there are none."""
    points = "".join(f"<li>{prose(item)}</li>" for item in items)
    return f"<ul>{points}</ul>" if points else ""


def columns(values: Mapping[str, Sequence[object]], numeric: int = 1) -> str:
    """Return a table of columns by their headings; those from `numeric` on are numbers."""
    rows = [[_cell(item) for item in row] for row in zip(*values.values(), strict=True)]
    return table(list(values), rows, numeric)


def next_steps(steps: Iterable[tuple[str, str]]) -> str:
    """Return the section of what to do next: a reason and a command of the shell each."""
    said = "".join(f"{paragraph(why)}<pre>{command(how)}</pre>" for why, how in steps)
    return section("What to do next", said, "next")


def key(meanings: Mapping[str, str]) -> str:
    """Return what words or colours mean, in small letters."""
    said = "".join(
        f"<dt>{escape(name)}</dt><dd>{prose(text)}</dd>" for name, text in meanings.items()
    )
    return f'<dl class="small">{said}</dl>'


def command(line: str) -> str:
    """Return a command of the shell as HTML; where it is long, it breaks between words only."""
    words = (escape(word) for word in line.split(" "))
    return " ".join(f'<span class="whole">{w}</span>' if "-" in w else w for w in words)


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], numeric: int = 0) -> str:
    """Return a table of HTML cells; columns from `numeric` on are numbers (0: none is)."""
    kinds = [' class="n"' if numeric and k >= numeric else "" for k in range(len(headings))]
    names = (escape(text).replace("[N m]", "[N&nbsp;m]") for text in headings)  # units stay whole
    head = "".join(f"<th{k}>{name}</th>" for k, name in zip(kinds, names, strict=True))
    body = "".join(
        "<tr>" + "".join(f"<td{k}>{c}</td>" for k, c in zip(kinds, cells, strict=True)) + "</tr>"
        for cells in rows
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def folded(title: str, body: str) -> str:
    """Return content that opens on demand."""
    return f"<details><summary>{escape(title)}</summary>{body}</details>"


def grid(items: Iterable[str], kind: str = "two") -> str:
    """Return items side by side where there is room."""
    return f'<div class="grid {kind}">{"".join(items)}</div>'


def paragraph(text: str, kind: str = "") -> str:
    """Return a paragraph."""
    return f"<p{f' class={kind!r}' if kind else ''}>{prose(text)}</p>"


def meter(share: float) -> str:
    """Return a small bar for a share of 0 to 1, with its figure."""
    width = min(max(share, 0.0), 1.0) * 100
    return (
        f'<span class="meter"><span style="width:{width:.0f}%"></span></span>'
        f"<span>{percent(share)}</span>"
    )


def number(value: float, digits: int = 3) -> str:
    """Return a number of few digits; a dash if it is not known."""
    return f"{value:.{digits}g}" if isfinite(value) else UNSAID


def significant(value: float, digits: int = 3) -> str:
    """Return a number of so many digits, zeros at its end among them; a dash if it is not known."""
    return f"{value:#.{digits}g}".rstrip(".") if isfinite(value) else UNSAID


def percent(share: float) -> str:
    """Return a share as a percentage; nearly all is not called all, nor hardly any none."""
    if not isfinite(share):
        return UNSAID
    if 0 < share < _HARDLY_ANY:
        return "less than 1\N{NO-BREAK SPACE}%"
    value = min(floor(1000 * share) / 10, 99.9) if _NEARLY_ALL < share < 1 else round(100 * share)
    return f"{value:g}\N{NO-BREAK SPACE}%"


def _cell(value: object) -> str:
    if value is None:
        return UNSAID
    return significant(value) if isinstance(value, float) else escape(typeset(str(value)))
