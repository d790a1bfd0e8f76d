"""The table shown: a page with errors beside the paper's, and its claims judged."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np

from estimators.studies.table1_claims import CLAIMS, NOTHING, cell, done, factor, judge
from estimators.studies.table1_data import ALL_ROWS, PARTS, RBD, paper_table
from estimators.studies.table1_results import (
    SCAFFOLDS,
    SEQUENCES,
    SPLIT_NAMES,
    SPLIT_WORDS,
    SPLITS,
    Protocol,
    Table,
)
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, BEFORE, FLOOR, layout, numbers
from limo_driver.pages.markup import Figure as Chart
from limo_driver.pages.markup import folded, grid, header, listed, section, table
from limo_driver.quoting import in_html as escape

PAGE: Final = "report.html"
_STYLES: Final = ((SEQUENCES, AFTER, "circle"), (SCAFFOLDS, BEFORE, "square"))
_SPLITS: Final = (
    "Inputs of networks: tau_rbd is the torque of the rigid body, r the rotation since the last "
    "reversal. Blue: random split of sub-sequences, as in the paper. Orange: tested on scaffolds "
    "that were never trained on. Diamonds: the paper's figures. Dotted: the rigid body alone. "
    "Bars: standard deviation over runs."
)
_JUDGED: Final = (
    "A factor is the joint-averaged MSE of the first row over that of the second, over runs of "
    "equal seeds, with its 95 % interval. A claim holds where all of it lies above 1."
)


def table_page(found: Table) -> Page:
    """Return the page of the table, as far as its trials are done."""
    charts = Charts()
    title = _title(found)
    drawn = grid(charts.place(_errors(found, part), part.capitalize()) for part in PARTS)
    n = found.data.model.n
    heads = ("architecture", "runs", *(f"joint {j}" for j in range(1, n + 1)), "average")
    body = ""
    for split in SPLITS:
        for part in PARTS:
            rows = [
                [escape(row.name), done(figures), *(cell(figures, i) for i in range(n + 1))]
                for of_split, of_part, row, figures in found.entries()
                if (of_split, of_part) == (split, part)
            ]
            body += folded(f"{part.capitalize()}, {SPLIT_NAMES[split]}", table(heads, rows, 1))
    topologies = [
        [part, str(layers), str(width), done(figures), cell(figures, n)]
        for part, layers, width, figures in found.topologies()
    ]
    heads = ("part", "layers", "width", "runs", "average")
    body += folded("Topology of LSTM-FCL 500 with tau_rbd,r", table(heads, topologies))
    body = (
        header("Table I of Çallar and Böttger 2022", title, found.headline())
        + section("Notes", listed(_known(found)), "notes")
        + section("Errors", drawn, "errors", _SPLITS)
        + section("The paper's claims", _claims(found), "claims", _JUDGED)
        + section("All figures", body, "table", found.scored)
    )
    return Page(title, body, charts)


def _title(found: Table) -> str:
    """Say which row is best on motion that was not trained on, and how far the rigid body is."""
    errors = {
        row.name: float(figures.mean[-1])
        for row in ALL_ROWS
        if (figures := found.figures(row, "test", SCAFFOLDS)).mean is not None
    }
    if len(errors) < 2:  # noqa: PLR2004  # to compare
        return f"Table I: {found.left} trials are still to be done."
    best = min(errors, key=lambda name: errors[name])
    rigid = errors.get(RBD.name)
    rigid_alone = (
        f", the rigid body alone {rigid:.3g}" if rigid is not None and best != RBD.name else ""
    )
    left = f"; {found.left} trials left" if found.left else ""
    return (
        f"Least error on scaffolds never trained on: {best}, MSE {errors[best]:.3g} (N m)²"
        f"{rigid_alone}{left}."
    )


def _known(found: Table) -> Iterator[str]:
    if found.protocol.epochs < Protocol.epochs:
        yield (
            f"No judgement of the paper: networks were trained for {found.protocol.epochs} of its "
            f"{Protocol.epochs} epochs. What is compared is how they begin to learn."
        )
    if found.protocol.runs == 1:
        yield "One run of each row: there is no interval, and the sign of one run proves nothing."
    if found.left:
        yield f"{found.left} trials are not done; the same command goes on with them."


def _errors(found: Table, part: str) -> Chart:
    names = [row.name for row in ALL_ROWS]
    data: list[Chart] = []
    for split, colour, symbol in _STYLES:
        figures = [found.figures(row, part, split) for row in ALL_ROWS]
        means = np.array([np.nan if f.mean is None else f.mean[-1] for f in figures])
        spreads = np.array([np.nan if f.spread is None else f.spread[-1] for f in figures])
        marks = _marks(means, names, SPLIT_WORDS[split], colour, symbol)
        data.append(marks | {"error_x": {"type": "data", "array": numbers(spreads)}})
    if found.beside_paper:
        data.append(_marks(_paper(part), names, "the paper", FLOOR, "diamond-open"))
    axes = layout("MSE [(N m)²], logarithmic", "")
    axes["xaxis"] |= {"type": "log"}
    axes["yaxis"] |= {"autorange": "reversed"}
    rigid = found.figures(RBD, part).mean
    if rigid is not None:
        line = {"color": FLOOR, "width": 1, "dash": "dot"}
        at = float(rigid[-1])
        axes["shapes"] = [
            {"type": "line", "x0": at, "x1": at, "y0": 0, "y1": 1, "yref": "paper", "line": line}
        ]
    return {"data": data, "layout": axes, "rows": len(names)}


def _paper(part: str) -> np.ndarray:
    """Return the paper's averages; NaN for rows that it lacks."""
    found = paper_table()
    return np.array([found.get((part, row.name), (np.nan,))[-1] for row in ALL_ROWS])


def _marks(values: np.ndarray, names: list[str], name: str, colour: str, symbol: str) -> Chart:
    return {
        "x": numbers(values), "y": names, "mode": "markers", "name": name,
        "marker": {"symbol": symbol, "size": 9, "color": colour},
        "hovertemplate": "%{y}, " + name + ": %{x} (N m)²<extra></extra>",
    }  # fmt: skip


def _claims(found: Table) -> str:
    body = ""
    for claim in CLAIMS:
        judged = list(judge(found, claim))
        compared = [item for item in judged if item.factor is not None]
        surely = sum(item.verdict == "holds" for item in compared)
        rows = [
            [
                *map(escape, (item.part, SPLIT_WORDS[item.split], item.worse, item.better)),
                factor(item),
                NOTHING if item.paper is None else f"{item.paper:.3g}",
                item.verdict,
            ]
            for item in judged
        ]
        heads = ("part", "split", "first", "second", "factor", "paper's", "verdict")
        title = f"{claim.title}: beyond the spread in {surely} of {len(compared)} comparisons"
        body += folded(title, f"<p>{escape(claim.says)}</p>" + table(heads, rows))
    return body
