"""A trial: one row of the table, trained once under one split; and where finished ones are kept."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Final

from estimators.reproduction.rows import PARTS, PERCEPTRON, ROWS, TOPOLOGIES, Row
from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import whole
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from estimators.hybrid.training.settings import TrainingSettings

SCHEMA: Final = 1
SEQUENCES, SCAFFOLDS = "sequences", "recordings"  # splits, as `TrainingSettings` calls them
SPLITS: Final = (SEQUENCES, SCAFFOLDS)
_SLOWER: Final = (None, "lstm-2", "lstm-fcl", PERCEPTRON, "transformer")  # one than the other
_DIGITS: Final = 10  # of the digest in a file name


@dataclass(frozen=True)
class Protocol(Declared):
    """Extent of the table that is computed; the defaults are the paper's.

    Raises:
        ConfigError: A number is below 1.
    """

    runs: int = parameter("", "trainings of each row, from other seeds", lower=1, default=10)
    epochs: int = parameter("", lower=1, default=100)
    batch: int = parameter(  # an MLP keeps the paper's rows
        "", "sub-sequences of one step of the optimiser", lower=1, default=50
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
        topologies = [row for row in TOPOLOGIES.values() if row not in ROWS]
        once = [(SEQUENCES, row) for row in ROWS]
        once += [(SCAFFOLDS, row) for row in ROWS]
        once += [(SEQUENCES, row) for row in topologies]
        once.sort(key=_slowness)
        return tuple(
            Trial(row, split, run, self._settings(row, split, run), digests)
            for run in range(self.runs)
            for split, row in once
        )

    def _settings(self, row: Row, split: str, run: int) -> TrainingSettings:
        settings = replace(row.settings(), split=split, seed=run, epochs=self.epochs)
        return settings if settings.model == PERCEPTRON else replace(settings, batch=self.batch)


def _slowness(once: tuple[str, Row]) -> int:
    return _SLOWER.index(once[1].model)


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
        del settings["device"]
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
