"""Gather the finished trials: mean and spread of each row, beside the paper's figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.reproduction.rows import (
    PAPER_JOINTS,
    PARTS,
    ROWS,
    TOPOLOGIES,
    Row,
    paper_table,
)
from estimators.reproduction.trial import SCAFFOLDS, SEQUENCES, SPLITS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from estimators.reproduction.data import TableData
    from estimators.reproduction.trial import Protocol, TrialResult, TrialStore
    from limo_driver.types import FloatArray

SCHEMA: Final = 1
SPLIT_WORDS: Final = {SEQUENCES: "random", SCAFFOLDS: "by scaffold"}  # in tables
SPLIT_NAMES: Final = {
    SEQUENCES: "random split of sub-sequences, as in the paper",
    SCAFFOLDS: "split by scaffold: all that was recorded around one is trained on, or is the test",
}
_SCORED: Final = (
    "Mean squared error [(N m)²] against the measured torque behind a zero-phase low-pass of "
    "10 Hz. Motion is cut into sub-sequences of T samples; a network starts each from zero memory "
    "and answers all of its samples, and all count. Validation motion is never trained on. Each "
    "run draws its split and initial weights anew; ± is the standard deviation over runs; "
)
_BRACKETS: Final = "in brackets, the paper's figure, of another arm."
_NO_BRACKETS: Final = (
    "the paper's figures, in N m of an iiwa, say nothing beside this arm's, and are left out. Rows "
    "are named as in the paper: MLP-7 is one perceptron for each joint, however many there are."
)
_PAPER_ARM: Final = "iiwa"  # in the name of a robot
_LONG: Final = 120.0  # [s], told in minutes from here on


@dataclass(frozen=True)
class Figures:
    """MSE of one row on one part of the motion, under one split."""

    runs: FloatArray  # (R, n) [(N m)²], of the finished runs in order
    numbers: tuple[int, ...]  # (R,), which runs these are
    left: int  # trials that are still to be done
    paper: FloatArray | None  # (n + 1,) [(N m)²], joints and average, as printed

    @property
    def each(self) -> FloatArray:
        """Figures of each run, (R, n + 1): joints and their average."""
        return np.column_stack([self.runs, self.runs.mean(axis=1)])

    @property
    def mean(self) -> FloatArray | None:
        """Mean over runs, (n + 1,); None before the first is finished."""
        return self.each.mean(axis=0) if self.numbers else None

    @property
    def spread(self) -> FloatArray | None:
        """Standard deviation over runs, (n + 1,); None for fewer than two."""
        return self.each.std(axis=0, ddof=1) if len(self.numbers) > 1 else None

    def as_values(self) -> dict[str, Any]:
        """Return plain values; the last of each list is the joint average."""
        return {
            "runs": list(self.numbers),
            "left": self.left,
            "mean": None if self.mean is None else self.mean.tolist(),
            "spread": None if self.spread is None else self.spread.tolist(),
            "paper": None if self.paper is None else self.paper.tolist(),
            "each_run": self.runs.tolist(),
        }


@dataclass(frozen=True)
class Table:
    """All figures of the table, and the data they were computed from."""

    data: TableData
    protocol: Protocol
    results: tuple[TrialResult, ...]

    @classmethod
    def gather(cls, data: TableData, protocol: Protocol, store: TrialStore) -> Table:
        """Collect the trials that are finished.

        Raises:
            ConfigError: The file of one was damaged.
        """
        found = (store.load(trial) for trial in protocol.trials(data.digests))
        return cls(data, protocol, tuple(result for result in found if result is not None))

    def figures(self, row: Row, part: str, split: str = SEQUENCES) -> Figures:
        """Return the figures of a row; `part` of PARTS, `split` of SPLITS."""
        own = [r for r in self.results if r.trial.row == row and r.trial.split == split]
        own.sort(key=lambda result: result.trial.run)
        return Figures(
            np.array([result.mse[part] for result in own]).reshape(len(own), self.data.model.n),
            tuple(result.trial.run for result in own),
            self.protocol.runs - len(own),
            paper_table().get((part, row.name)) if self.beside_paper else None,
        )

    @property
    def beside_paper(self) -> bool:
        """Whether the paper's figures stand beside these: errors in N m grow with the arm."""
        return _PAPER_ARM in self.data.robot.lower() and self.data.model.n == PAPER_JOINTS

    @property
    def scored(self) -> str:
        """Say what the figures measure."""
        return _SCORED + (_BRACKETS if self.beside_paper else _NO_BRACKETS)

    @property
    def left(self) -> int:
        """Trials that are still to be done."""
        return len(self.protocol.trials(self.data.digests)) - len(self.results)

    def entries(self) -> Iterable[tuple[str, str, Row, Figures]]:
        """Give split, part, row and figures of the whole table, in its order."""
        for split in SPLITS:
            for part in PARTS:
                for row in ROWS:
                    yield split, part, row, self.figures(row, part, split)

    def topologies(self) -> Iterable[tuple[str, int, int, Figures]]:
        """Give part, layers, width and figures of the comparison of topologies."""
        for part in PARTS:
            for (layers, width), row in TOPOLOGIES.items():
                yield part, layers, width, self.figures(row, part)

    def about(self) -> dict[str, Any]:
        """Say what the figures were computed from and how, as plain values."""
        data = self.data
        return {
            "data": {
                "folder": str(data.folder),
                "made_by": data.made_by,
                "robot": data.robot,
                "samples": len(data.limo),
                "seconds": data.limo.duration,
                "rate": data.limo.rate,
                "scaffolds": int(data.scaffold_starts.size),
                "validation_samples": len(data.validation),
                "sha256": dict(data.digests),
            },
            "runs": self.protocol.runs,
            "epochs": self.protocol.epochs,
            "batch": self.protocol.batch,
            "trials_left": self.left,
            "scored": self.scored,
        }

    def headline(self) -> str:
        """Say in a sentence or two what data these are and how much of the table is done."""
        data, done = self.data, len(self.results)
        return (
            f"Data: {data.folder}, made by {data.made_by}. {len(data.limo)} samples of "
            f"{data.robot} at {data.limo.rate:.4g} Hz, {span(data.limo.duration)} with "
            f"{data.scaffold_starts.size} scaffolds; validation {span(data.validation.duration)}. "
            f"{self.protocol}; "
            f"{done} of {done + self.left} trials done."
        )


def span(seconds: float) -> str:
    """Print a duration in seconds, or in minutes if there are some."""
    return f"{seconds:.0f} s" if seconds < _LONG else f"{seconds / 60:.1f} min"
