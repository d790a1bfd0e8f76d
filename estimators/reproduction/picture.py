"""Draw the table: joint-averaged errors of every row, beside the paper's for its arm."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure

from estimators.reproduction.data import PARTS, RBD, ROWS, paper_table
from estimators.reproduction.results import SCAFFOLDS, SEQUENCES, span
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.reproduction.results import Table

PICTURE: Final = "table1.png"
_TITLE: Final = 140  # characters of a line
_STYLES: Final = {  # split → label, colour, marker, offset from the middle of a row
    SEQUENCES: ("ours, random sub-sequences", "#1f77b4", "o", -0.17),
    SCAFFOLDS: ("ours, split by scaffold", "#d95f02", "s", 0.17),
}


def draw(table: Table, path: Path) -> None:
    """Draw a panel for each part of the motion; rows from top to bottom, errors on one log axis."""
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    panels: Any = figure.subplots(1, len(PARTS), sharex=True, sharey=True)
    for panel, part in zip(panels, PARTS, strict=True):
        _panel(panel, table, part)
    panels[0].set_yticks(range(len(ROWS)), [row.name for row in ROWS])
    panels[0].set_ylim(len(ROWS) - 0.5, -0.5)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    left = f"; {table.left} trials left" if table.left else ""
    data = table.data
    title = (
        f"Table I of Çallar and Böttger 2022 on {data.robot}, {span(data.limo.duration)} to train "
        f"and test on, made by {data.made_by}"
    )
    whiskers = "; whiskers: standard deviation over runs" if table.protocol.runs > 1 else ""
    figure.suptitle(f"{fill(title, _TITLE)}\n{table.protocol}{left}{whiskers}", fontsize="medium")
    with whole(path) as draft:
        figure.savefig(draft, format=path.suffix[1:], dpi=150)


def _panel(panel: Any, table: Table, part: str) -> None:  # noqa: ANN401  # matplotlib's Axes
    places = np.arange(len(ROWS))
    if table.beside_paper:
        paper = [paper_table()[part, row.name][-1] for row in ROWS]
        panel.plot(paper, places, "D", color="0.45", fillstyle="none", label="the paper")
    rigid = table.figures(RBD, part).mean
    if rigid is not None:
        panel.axvline(rigid[-1], color="0.45", linestyle=":", label="the rigid body alone")
    for split, (label, colour, marker, offset) in _STYLES.items():
        figures = [table.figures(row, part, split) for row in ROWS]
        means = [np.nan if f.mean is None else f.mean[-1] for f in figures]
        spreads = [0.0 if f.spread is None else f.spread[-1] for f in figures]
        panel.errorbar(
            means,
            places + offset,
            xerr=_whiskers(means, spreads),
            fmt=marker,
            color=colour,
            markersize=5,
            capsize=2,
            label=label,
        )
    panel.set_xscale("log")
    panel.set_title(part)
    panel.set_xlabel("joint-averaged MSE [(N m)²]")
    panel.grid(axis="x", which="major", color="0.85")
    panel.set_axisbelow(True)
    for place in places[:-1]:
        panel.axhline(place + 0.5, color="0.93", linewidth=0.8)


def _whiskers(means: list[float], spreads: list[float]) -> list[list[float]]:
    """Keep the lower whisker above zero, which a logarithmic axis does not have."""
    return [np.minimum(spreads, 0.9 * np.nan_to_num(means)).tolist(), spreads]
