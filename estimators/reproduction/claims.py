"""The paper's claims, judged by figures: by which factor one row is better, and how surely."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.stats import t as student

from estimators.reproduction import rows as r
from estimators.reproduction.rows import PARTS, ROWS, TOPOLOGIES, Row
from estimators.reproduction.trial import SCAFFOLDS, SEQUENCES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.reproduction.results import Table

_CONFIDENCE: Final = 0.95


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
        """Say whether the claim holds: surely, surely not, or not told yet."""
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


def best(table: Table, part: str, split: str) -> tuple[str, str] | None:
    """Return the rows of least mean error, ours and the paper's, or None before any is done."""
    ours = [
        (float(figures.mean[-1]), row.name)
        for row in ROWS
        if (figures := table.figures(row, part, split)).mean is not None
    ]
    paper = [(float(mse[-1]), name) for (of, name), mse in r.paper_table().items() if of == part]
    return (min(ours)[1], min(paper)[1]) if ours else None
