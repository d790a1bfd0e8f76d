"""Files of the table: table1.json, table1.csv, table1.md and claims.md."""

from __future__ import annotations

import csv
import json
from io import StringIO
from typing import TYPE_CHECKING, Any, Final

from estimators.reproduction.claims import CLAIMS, best, judge
from estimators.reproduction.results import SCHEMA, SPLIT_NAMES, SPLIT_WORDS
from estimators.reproduction.rows import PARTS
from estimators.reproduction.trial import SPLITS, Protocol, write_whole
from limo_driver.quoting import in_markdown

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from estimators.reproduction.claims import Judgement
    from estimators.reproduction.results import Figures, Table

JSON, CSV, MARKDOWN, CLAIMS_FILE = "table1.json", "table1.csv", "table1.md", "claims.md"
NOTHING: Final = "-"  # stands where no trial is finished
_SOURCE: Final = (
    'The paper: Çallar and Böttger, "Hybrid Learning of Time-Series Inverse Dynamics Models for '
    'Locally Isotropic Robot Motion", RA-L 2022, Table I.'
)


def write(table: Table, folder: Path) -> None:
    """Write all files, each whole or not at all."""
    write_whole(folder / JSON, json.dumps(_values(table), indent=1, allow_nan=False))
    write_whole(folder / CSV, _csv(table))
    write_whole(folder / MARKDOWN, _markdown(table))
    write_whole(folder / CLAIMS_FILE, _claims(table))


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


def _csv(table: Table) -> str:
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [*(f"joint_{j + 1}" for j in range(table.data.model.n)), "joint_average"]
    writer.writerow(
        ["split", "part", "architecture", "runs", "left"]
        + [f"{name}{suffix}" for suffix in ("", "_spread", "_paper") for name in names]
    )
    for split, part, row, figures in table.entries():
        values: list[str] = []
        for which in (figures.mean, figures.spread, figures.paper):
            values += [""] * len(names) if which is None else map(repr, which.tolist())
        writer.writerow([split, part, row.name, len(figures.numbers), figures.left, *values])
    return text.getvalue().rstrip("\n")


def _markdown(table: Table) -> str:
    n = table.data.model.n
    lines = ["# Table I", "", in_markdown(table.headline()), "", table.scored, "", _SOURCE]
    for split in SPLITS:
        lines += ["", f"## {SPLIT_NAMES[split][0].upper()}{SPLIT_NAMES[split][1:]}"]
        for part in PARTS:
            rows = (
                [row.name, done(figures), *(cell(figures, i) for i in range(n + 1))]
                for s, p, row, figures in table.entries()
                if (s, p) == (split, part)
            )
            head = ["architecture", "runs", *(f"joint {j + 1}" for j in range(n)), "average"]
            lines += ["", f"### {part.capitalize()}", "", *_grid(head, rows)]
    lines += ["", "## Topology of LSTM-FCL 500 with tau_rbd,r (joint average)", ""]
    lines += _grid(
        ["part", "layers", "width", "runs", "MSE"],
        (
            [part, str(layers), str(width), done(figures), cell(figures, n)]
            for part, layers, width, figures in table.topologies()
        ),
    )
    return "\n".join(lines)


def _claims(table: Table) -> str:
    lines = [
        "# The paper's claims",
        "",
        in_markdown(table.headline()),
        "",
        "A factor is the joint-averaged MSE of the first row over that of the second, geometric "
        "mean over runs of equal seeds, with its 95 % interval. A claim holds for a pair when the "
        "whole interval lies above 1, does not hold when it lies below, and is open in between. "
        "With one run there is no interval, and the sign of one run proves nothing.",
    ]
    if (epochs := table.protocol.epochs) < Protocol.epochs:
        lines += [
            "",
            f"**No judgement of the paper: the networks were trained for {epochs} epoch"
            f"{'s' if epochs > 1 else ''}, the paper's for {Protocol.epochs}.** What is compared "
            "here is how they begin to learn.",
        ]
    for claim in CLAIMS:
        judged = list(judge(table, claim))
        told = [j for j in judged if j.factor is not None]
        hold = sum(j.factor is not None and j.factor > 1 for j in told)
        surely = sum(j.verdict == "holds" for j in told)
        lines += [
            "",
            f"## {claim.title}",
            "",
            f"The paper: {claim.says} Here: in {hold} of {len(told)} comparisons done "
            f"({len(judged)} in all), in {surely} beyond the spread.",
            "",
            *_grid(
                ["part", "split", "first", "second", "factor", "paper's", "runs", "verdict"],
                (
                    [
                        *(j.part, SPLIT_WORDS[j.split], j.worse, j.better, factor(j)),
                        NOTHING if j.paper is None else f"{j.paper:.3g}",
                        *(str(j.runs), j.verdict),
                    ]
                    for j in judged
                ),
            ),
        ]
    return "\n".join([*lines, "", "## Least error", "", *_winners(table)])


def _winners(table: Table) -> Iterable[str]:
    """Give the winners of each part as lines of a table."""
    found = [(split, part, best(table, part, split)) for split in SPLITS for part in PARTS]
    return _grid(
        ["split", "part", "ours", "paper's"],
        ([SPLIT_WORDS[split], part, *(names or (NOTHING,) * 2)] for split, part, names in found),
    )


def _grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    return [
        _line(head),
        _line(["---"] * len(head)),
        *(_line(row) for row in rows),
    ]


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
