"""The table shown: a page with errors beside the paper's, and its claims judged.

The paper's claims, what came out, and both in words.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.stats import t as student

from estimators.studies import table1_data as r
from estimators.studies.table1_data import ALL_ROWS, PARTS, RBD, ROWS, TOPOLOGIES, Row, paper_table
from estimators.studies.table1_results import (
    SCAFFOLDS,
    SCHEMA,
    SEQUENCES,
    SPLIT_NAMES,
    SPLIT_WORDS,
    SPLITS,
    Protocol,
    Table,
    write_whole,
)
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, BEFORE, FLOOR, layout, numbers
from limo_driver.pages.markup import Figure as Chart
from limo_driver.pages.markup import folded, grid, header, listed, section, table
from limo_driver.quoting import in_html as escape

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.studies.table1_results import Figures


_CONFIDENCE: Final = 0.95
JSON: Final = "table1.json"
NOTHING: Final = "-"  # stands where no trial is finished


@dataclass(frozen=True)
class Claim:
    """Claim of the paper, and the pairs of rows (worse, better) that it is about."""

    title: str
    says: str
    pairs: tuple[tuple[Row, Row], ...]
    parts: tuple[str, ...] = PARTS


_TEST: Final = ("training", "test")
_VALIDATION: Final = ("validation",)

CLAIMS: Final = (
    Claim(
        "Hybrid against standalone",
        "Models trained in hybrid configuration achieve lower errors on all data.",
        (
            (r.MLP, r.MLP_HYBRID),
            (r.LSTM2, r.LSTM2_HYBRID),
            (r.FCL100_HISTORY, r.FCL100_FULL),
            (r.FCL500, r.FCL500_HYBRID),
        ),
    ),
    Claim(
        "Rotational history r against none",
        "Each model with r outperforms its counterpart; less so on validation.",
        (
            (r.MLP_HYBRID, r.MLP_FULL),
            (r.LSTM2_HYBRID, r.LSTM2_FULL),
            (r.FCL100, r.FCL100_HISTORY),
            (r.FCL500_HYBRID, r.FCL500_FULL),
        ),
    ),
    Claim(
        "T = 500 against T = 100",
        "Longer sequences hold more that can be used.",
        ((r.FCL100, r.FCL500), (r.FCL100_FULL, r.FCL500_FULL)),
        _TEST,
    ),
    Claim(
        "Recurrence against attention",
        "The Transformer yields no improvement over the LSTM-FCL.",
        ((r.TRANSFORMER, r.FCL500_FULL),),
        _TEST,
    ),
    Claim(
        "Time series against single samples",
        "On LIMO motion, networks with memory are more accurate than perceptrons.",
        ((r.MLP_FULL, r.LSTM2_FULL), (r.MLP_FULL, r.FCL100_FULL), (r.MLP_FULL, r.FCL500_FULL)),
        _TEST,
    ),
    Claim(
        "The rigid body against hybrids",
        "On LIMO motion, the rigid body alone is far worse than hybrids.",
        ((r.RBD, r.MLP_HYBRID), (r.RBD, r.FCL500_FULL)),
        _TEST,
    ),
    Claim(
        "The perceptron on validation",
        "The hybrid MLP is best on motion that is not LIMO.",
        tuple((row, r.MLP_FULL) for row in ROWS if row != r.MLP_FULL),
        _VALIDATION,
    ),
    Claim(
        "Topology of LSTM-FCL 500",
        "A second layer and a wider cell each add accuracy.",
        (
            *((TOPOLOGIES[1, width], TOPOLOGIES[2, width]) for width in (15, 35, 55)),
            *((TOPOLOGIES[layers, 15], TOPOLOGIES[layers, 55]) for layers in (1, 2)),
        ),
        _TEST,
    ),
)


@dataclass(frozen=True)
class Judgement:
    """MSE of one row over that of another, averaged over joints."""

    worse: str
    better: str
    part: str
    split: str
    factor: float | None  # geometric mean over runs; None before both have finished a run
    low: float | None  # 95 % interval of it; None for fewer than two runs
    high: float | None
    runs: int  # in which both rows are done
    paper: float | None

    @property
    def verdict(self) -> str:
        """Say whether the claim holds: surely, surely not, or not compared yet."""
        if self.factor is None:
            return "-"
        if self.low is None or self.high is None:
            return "as claimed in the one run" if self.factor > 1 else "not in the one run"
        if self.low > 1:
            return "holds"
        return "does not hold" if self.high < 1 else "within the spread"

    def as_values(self) -> dict[str, Any]:
        """Return plain values."""
        return {**vars(self), "verdict": self.verdict}


def judge(table: Table, claim: Claim) -> Iterator[Judgement]:
    """Judge a claim, pair by pair, under the paper's split and the one by scaffold.

    Runs with the same seed are compared; the interval is Student's, of the mean logarithm of their
    ratios.
    """
    for part in claim.parts:
        for worse, better in claim.pairs:
            topology = worse not in ROWS or better not in ROWS
            for split in (SEQUENCES,) if topology else (SEQUENCES, SCAFFOLDS):
                yield _judgement(table, worse, better, part, split)


def _judgement(table: Table, worse: Row, better: Row, part: str, split: str) -> Judgement:
    first, second = (table.figures(row, part, split) for row in (worse, better))
    theirs = dict(zip(first.numbers, first.each[:, -1], strict=True))
    own = dict(zip(second.numbers, second.each[:, -1], strict=True))
    logs = np.log([theirs[run] / own[run] for run in sorted(theirs.keys() & own.keys())])
    factor = low = high = None
    if logs.size:
        factor = float(np.exp(logs.mean()))
    if logs.size > 1:
        reach = student.ppf((1 + _CONFIDENCE) / 2, logs.size - 1) * logs.std(ddof=1)
        low, high = np.exp(logs.mean() + np.array([-1, 1]) * reach / np.sqrt(logs.size)).tolist()
    printed = [r.paper_table().get((part, row.name)) for row in (worse, better)]
    paper = None
    if printed[0] is not None and printed[1] is not None:
        paper = float(printed[0][-1] / printed[1][-1])  # of errors: holds beside any arm's
    return Judgement(worse.name, better.name, part, split, factor, low, high, logs.size, paper)


def write(table: Table, folder: Path) -> None:
    """Write the figures as JSON, whole or not at all."""
    write_whole(folder / JSON, json.dumps(_values(table), indent=1, allow_nan=False))


def number(value: float) -> str:
    """Print an MSE as the paper does, with four digits, or with three that count if it is small."""
    return f"{value:.4f}" if value >= 0.01 else f"{value:.3g}"  # noqa: PLR2004


def cell(figures: Figures, i: int) -> str:
    """Print a joint's figure (the last is the average): mean ± spread (paper's)."""
    if figures.mean is None:
        text = NOTHING
    elif figures.spread is None:
        text = number(figures.mean[i])
    else:
        text = f"{number(figures.mean[i])} ± {number(figures.spread[i])}"
    return text if figures.paper is None else f"{text} ({figures.paper[i]:.4f})"


def done(figures: Figures) -> str:
    """Print how many runs are behind a row and how many are to come."""
    finished = len(figures.numbers)
    return f"{finished}, {figures.left} left" if figures.left else str(finished)


def factor(judgement: Judgement) -> str:
    """Print a factor and its interval."""
    if judgement.factor is None:
        return NOTHING
    if judgement.low is None or judgement.high is None:
        return f"{judgement.factor:.3g}"
    return f"{judgement.factor:.3g} ({judgement.low:.3g} to {judgement.high:.3g})"


def _values(table: Table) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        **table.about(),
        "columns": [*(f"joint_{j + 1}" for j in range(table.data.model.n)), "joint_average"],
        "table": [
            {"split": split, "part": part, "architecture": row.name, **figures.as_values()}
            for split, part, row, figures in table.entries()
        ],
        "topologies": [
            {"part": part, "layers": layers, "width": width, **figures.as_values()}
            for part, layers, width, figures in table.topologies()
        ],
        "claims": [
            {"claim": claim.title, **judgement.as_values()}
            for claim in CLAIMS
            for judgement in judge(table, claim)
        ],
    }


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
        paper = paper_table()  # which lacks some rows
        means = np.array([paper.get((part, row.name), (np.nan,))[-1] for row in ALL_ROWS])
        data.append(_marks(means, names, "the paper", FLOOR, "diamond-open"))
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
