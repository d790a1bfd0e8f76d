"""Trials of the table, kept one by one, and what all of them come to."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.hybrid.training.settings import TrainingSettings
from estimators.studies.table1_data import (
    ALL_ROWS,
    PAPER_JOINTS,
    PARTS,
    PERCEPTRON,
    TOPOLOGIES,
    Row,
    TableData,
    paper_table,
)
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import whole
from limo_driver.runtime.parameters import Declared, parameter
from limo_driver.types import FloatArray

SCHEMA: Final = 1
SEQUENCES, SCAFFOLDS = "sequences", "recordings"  # splits, as `TrainingSettings` calls them
SPLITS: Final = (SEQUENCES, SCAFFOLDS)
_SLOWER: Final = (
    None,
    "lru",
    "gru",
    "lstm-2",
    "lstm-fcl",
    PERCEPTRON,
    "transformer",
)  # one than the other
_DIGITS: Final = 10  # of the digest in a file name
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
class Protocol(Declared):
    """Extent of the table that is computed; the defaults are the paper's.

    Args:
        runs: Trainings of each row, from other seeds.
        batch: Sub-sequences of one step of the optimiser.

    Raises:
        ConfigError: A number is below 1.
    """

    runs: int = parameter("", lower=1, default=10)
    epochs: int = parameter("", lower=1, default=100)
    batch: int = parameter(  # an MLP keeps the paper's rows
        "", lower=1, default=50
    )

    def __str__(self) -> str:
        """Name the numbers, as `10 runs of 100 epochs, batches of 50 sub-sequences`."""
        runs = f"{self.runs} run{'s' if self.runs > 1 else ''}"
        epochs = f"{self.epochs} epoch{'s' if self.epochs > 1 else ''}"
        sequences = f"{self.batch} sub-sequence{'s' if self.batch > 1 else ''}"
        return f"{runs} of {epochs}, batches of {sequences}"

    def trials(self, digests: Mapping[str, str]) -> tuple[Trial, ...]:
        """Return all trials: one run after the other, and in each what takes longest at its end.

        So most of the table is there soon.

        Args:
            digests: sha256 of the data.
        """
        topologies = [row for row in TOPOLOGIES.values() if row not in ALL_ROWS]
        once = [(SEQUENCES, row) for row in ALL_ROWS]
        once += [(SCAFFOLDS, row) for row in ALL_ROWS]
        once += [(SEQUENCES, row) for row in topologies]
        once.sort(key=lambda item: _SLOWER.index(item[1].model))
        return tuple(
            Trial(row, split, run, self._settings(row, split, run), digests)
            for run in range(self.runs)
            for split, row in once
        )

    def _settings(self, row: Row, split: str, run: int) -> TrainingSettings:
        settings = replace(row.settings(), split=split, seed=run, epochs=self.epochs)
        return settings if settings.model == PERCEPTRON else replace(settings, batch=self.batch)


@dataclass(frozen=True)
class Trial:
    """One training, and the settings that identify it."""

    row: Row
    split: str  # of SPLITS
    run: int  # from 0; the seed
    settings: TrainingSettings
    digests: Mapping[str, str]  # sha256 of each file of the data

    @cached_property
    def identity(self) -> dict[str, Any]:
        """All that the figures depend on, as JSON values; not the device they come from."""
        settings = asdict(self.settings)
        del settings["device"], settings["patience"]  # the paper has none
        identity = {
            "schema": SCHEMA,
            "row": asdict(self.row),
            "split": self.split,
            "run": self.run,
            "settings": settings,
            "data": dict(self.digests),
        }
        return json.loads(json.dumps(identity))  # tuples as lists, as they are read back

    @cached_property
    def file_name(self) -> str:
        """Name that another setting or other data would change."""
        digest = sha256(json.dumps(self.identity, sort_keys=True).encode()).hexdigest()
        words = "".join(c if c.isalnum() else "_" for c in self.row.name.lower())
        return f"{words}-{self.split}-run{self.run}-{digest[:_DIGITS]}.json"


@dataclass(frozen=True)
class TrialResult:
    """Figures of a finished trial."""

    trial: Trial
    mse: Mapping[str, tuple[float, ...]]  # of PARTS, each joint [(N m)²]
    epochs: int  # trained
    seconds: float
    device: str
    packages: Mapping[str, str]  # versions


@dataclass(frozen=True)
class TrialStore:
    """Folder of finished trials, each a file that is there whole or not at all.

    A trial on another rigid body is not finished. Files of the first versions do not say on which
    they were done; these are taken, since the data that it is identified from are the same.
    """

    folder: Path
    rigid_body: str  # digest of its physics

    def load(self, trial: Trial) -> TrialResult | None:
        """Return what an equal trial gave, or None if none is finished.

        Raises:
            ConfigError: Its file was damaged.
        """
        path = self.folder / trial.file_name
        if not path.exists():
            return None
        try:
            values = json.loads(path.read_text())
            mse = {part: tuple(map(float, values["mse"][part])) for part in PARTS}
            if values["trial"] != trial.identity:
                raise ValueError("it is of another trial than its name says")
            if values.get("rigid_body", self.rigid_body) != self.rigid_body:
                return None
            return TrialResult(
                trial,
                mse,
                int(values["epochs"]),
                float(values["seconds"]),
                str(values["device"]),
                dict(values["packages"]),
            )
        except (OSError, KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"cannot be read as a finished trial ({error}); delete it to have it done again",
                path=path,
            ) from None

    def save(self, result: TrialResult) -> None:
        """Write a finished trial."""
        values = {
            "trial": result.trial.identity,
            "rigid_body": self.rigid_body,
            "mse": {part: list(result.mse[part]) for part in PARTS},
            "epochs": result.epochs,
            "seconds": result.seconds,
            "device": result.device,
            "packages": dict(result.packages),
        }
        write_whole(
            self.folder / result.trial.file_name, json.dumps(values, indent=1, allow_nan=False)
        )


def write_whole(path: Path, text: str) -> None:
    """Write a text file at once, so that a killed process leaves the old one or the new."""
    with whole(path) as draft:
        draft.write_text(text + "\n", encoding="utf-8")


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
                for row in ALL_ROWS:
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
