"""Settings to try, and the trials of them, kept one by one.

The space of a sweep: which settings of training are tried.

```yaml
model: [mlp7, lstm-fcl]     # every combination of what is listed
features: drive             # one value: the same for all
hidden: [8, 16]
seed: [0, 1, 2]             # the spread over these is shown beside each setting
learning_rate: {from: 3e-4, to: 1e-2, scale: log}
draws: 4                    # numbers from each range, the same for each combination
```
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from itertools import product
from json import dumps
from math import exp, log, prod
from pathlib import Path
from typing import Any, Final

import numpy as np

from estimators.hybrid import HybridModel
from estimators.hybrid.fitted_network import FittedNetwork
from estimators.hybrid.training.data import LEFT_OUT, prepare
from estimators.hybrid.training.settings import TrainingSettings, usual_settings
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.declarations import ConfigNode, read_yaml
from limo_driver.runtime.outputs import KeptResults
from limo_driver.runtime.parameters import (
    REAL,
    TEXT,
    WHOLE,
    Declared,
    Parameter,
    parameter,
    parameters_of,
)
from limo_driver.types import FloatArray

MODEL: Final = "model"  # folder of a trial's model, as `limo train` writes it
_DIGITS: Final = 24  # of a key: 96 bits
_MOST: Final = 10_000  # trials
_OWN: Final = ("device",)  # where it is trained, and not what
_SWEPT: Final = {
    item.name: item for item in parameters_of(TrainingSettings) if item.name not in _OWN
} | {"features": Parameter("features", kind=TEXT)}


@dataclass(frozen=True)
class SweepTrial:
    """Settings, and how well a network trained with them predicts motion that it did not see."""

    settings: TrainingSettings
    key: str  # changes with settings, data and version of limo; not with the device
    left: float = float("nan")  # part of the simulation's error that is left; see `error_left`
    test: float = float("nan")  # the same of the test recordings, where some are given
    rmse: tuple[float, ...] = ()  # (n,) [N m], of motion not seen
    seconds: float = 0.0  # that training took
    error: str = ""  # one line, where there is no network
    folder: Path | None = None  # of the model

    @property
    def trained(self) -> bool:
        """Whether there is a network."""
        return not self.error


@dataclass(frozen=True)
class SweepOutcome:
    """How a trial ended, as a value that crosses processes and machines."""

    seconds: float
    error: str = ""
    left: float = float("nan")
    test: float = float("nan")
    rmse: tuple[float, ...] = ()
    fitted: FittedNetwork | None = None


@dataclass(frozen=True)
class SweepStore:
    """Finished trials in a folder."""

    kept: KeptResults
    simulation: Simulation  # that every model adds to

    @classmethod
    def at(cls, folder: Path, simulation: Simulation) -> SweepStore:
        """Return the store in a folder of a sweep."""
        return cls(KeptResults(folder / "trials", "trial.json"), simulation)

    def keep(self, trial: SweepTrial, outcome: SweepOutcome) -> None:
        """Keep how a trial ended.

        Raises:
            ConfigError: It cannot be written.
        """
        record = {
            name: getattr(outcome, name) for name in ("seconds", "error", "left", "test", "rmse")
        }

        def saved(place: Path) -> None:
            if outcome.fitted is not None:
                model = HybridModel(self.simulation, trial.settings)
                model.fitted_ = outcome.fitted
                model.save(place / MODEL)

        self.kept.keep(trial.key, record | {"settings": asdict(trial.settings)}, {}, saved)

    def finished(self, trial: SweepTrial) -> SweepTrial | None:
        """Return a trial with how it ended; None while it has not."""
        kept = self.kept.finished(trial.key)
        if kept is None:
            return None
        try:
            found = replace(
                trial,
                **{name: float(kept[name]) for name in ("seconds", "left", "test")},
                error=str(kept["error"]),
                rmse=tuple(map(float, kept["rmse"])),
            )
        except (KeyError, TypeError, ValueError):
            return None
        folder = self.kept.place(trial.key) / MODEL
        return found if found.error else replace(found, folder=folder) if folder.is_dir() else None


def key_of_trial(settings: TrainingSettings, data: str) -> str:
    """Return the key of a trial.

    Args:
        settings: Of training.
        data: Digest of the simulation, the recordings and limo's version.
    """
    values: dict[str, Any] = asdict(settings)
    del values["device"]
    return sha256(dumps([values, data]).encode()).hexdigest()[:_DIGITS]


def judged(
    model: HybridModel, recordings: Sequence[Recording], settings: TrainingSettings
) -> tuple[float, tuple[float, ...]]:
    """Return what a network leaves of the simulation's error, and its RMSE (n,) [N m].

    Both are of what it was trained to predict, in stretches that the networks which predict them
    did not see. Without folds there are none: then of the held-out motion, which has chosen the
    weights that are kept, and both filtered, as the model is used.

    Args:
        model: Trained.
        recordings: That it was trained on.
        settings: Of its training.
    """
    rmse = model.fitted.record["rmse"]
    if "left_out" not in rmse:
        own, rigid = (np.array(rmse["held_out"][name]) for name in ("hybrid", "rigid_body"))
        return error_left(own, rigid), tuple(own.tolist())
    own = np.array(rmse["left_out"]["hybrid"])
    data = prepare(model.simulation, recordings, settings, np.random.default_rng(settings.seed))
    residual = data.output_scaling.restore(data.targets[data.use != LEFT_OUT].astype(np.float64))
    return error_left(own, np.sqrt(np.mean(residual**2, axis=0))), tuple(own.tolist())


def error_left(own: FloatArray, simulation: FloatArray) -> float:
    """Return the part of the simulation's error that is left, each joint as important as another.

    Args:
        own: RMSE of simulation and network, (n,) [N m].
        simulation: RMSE of the simulation alone, (n,) [N m].
    """
    return float(np.sqrt(np.mean((own / simulation) ** 2)))


@dataclass(frozen=True)
class SweptRange(Declared):
    """Numbers that are drawn between two."""

    low: float = parameter("", key="from")
    high: float = parameter("", key="to")
    scale: str = parameter("", of=("linear", "log"), default="linear")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            raise ConfigError(f"from {self.low:g} to {self.high:g}, expected a larger number last")
        if self.scale == "log" and self.low <= 0:
            raise ConfigError(f"from {self.low:g}, expected a number above 0 on a log scale")

    def at(self, part: float) -> float:
        """Return the number at a part of the way, from 0 to 1."""
        if self.scale == "log":
            return exp(log(self.low) + part * log(self.high / self.low))
        return self.low + part * (self.high - self.low)


@dataclass(frozen=True)
class SweepSpace:
    """Settings that are tried: every combination of values, with every draw from the ranges.

    Args:
        values: Of settings of training, by name; those not named are the usual ones.
        ranges: From which numbers are drawn, by name.
        draws: From each range.
        draw_seed: Of the draws; the same gives the same, whatever else is in the space.

    Raises:
        ConfigError: There is no such setting, or a combination cannot be trained.
    """

    values: Mapping[str, tuple[Any, ...]]
    ranges: Mapping[str, SweptRange]
    draws: int = 1
    draw_seed: int = 0

    @classmethod
    def load(cls, path: Path) -> SweepSpace:
        """Read a space.yaml.

        Raises:
            ConfigError: Names what cannot be used, and its line.
        """
        space = read_yaml(path, "settings of training, such as `hidden: [8, 16]`")
        space.only(*_SWEPT, "draws", "draw_seed")
        values: dict[str, tuple[Any, ...]] = {}
        ranges: dict[str, SweptRange] = {}
        for name, known in _SWEPT.items():
            if name not in space:
                continue
            if known.kind in {REAL, WHOLE} and space[name].items is None:
                ranges[name] = space[name].make(SweptRange)
            else:
                values[name] = _values(space[name], known)
        draws, seed = (
            space.take(Parameter(name, kind=WHOLE, lower=lower)) if name in space else default
            for name, lower, default in (("draws", 1, 1), ("draw_seed", 0, 0))
        )
        if draws > 1 and not ranges:
            space["draws"].refuse("1 where there is no range `{from: ..., to: ...}` to draw from")
        return cls(values, ranges, draws, seed)

    @property
    def varied(self) -> tuple[str, ...]:
        """What differs from trial to trial, but for seeds."""
        listed = [name for name, values in self.values.items() if len(values) > 1]
        return tuple(name for name in (*listed, *self.ranges) if name != "seed")

    def settings(self, bandwidth: float) -> tuple[TrainingSettings, ...]:
        """Return the settings of every trial, in order; every one is checked.

        Args:
            bandwidth: Where the space has none [Hz].

        Raises:
            ConfigError: Names a combination that cannot be trained.
        """
        count = prod(map(len, self.values.values())) * (self.draws if self.ranges else 1)
        if count > _MOST:
            raise ConfigError(f"the space has {count} trials, expected {_MOST} at most")
        return tuple(
            self._made({"bandwidth": bandwidth, **dict(zip(self.values, chosen, strict=True)), **d})
            for chosen in product(*self.values.values())
            for d in self._drawn()
        )

    def _drawn(self) -> list[dict[str, Any]]:
        if not self.ranges:
            return [{}]
        parts = np.random.default_rng(self.draw_seed).random((self.draws, len(self.ranges)))
        return [
            {
                name: round(own.at(part)) if _SWEPT[name].kind == WHOLE else own.at(part)
                for (name, own), part in zip(self.ranges.items(), row, strict=True)
            }
            for row in parts.tolist()
        ]

    def _made(self, chosen: Mapping[str, Any]) -> TrainingSettings:
        try:
            own = {"features": TrainingSettings.features} | dict(chosen)
            return replace(usual_settings(own["features"], own.get("model", "mlp7")), **chosen)
        except ConfigError as error:
            combination = ", ".join(f"{name}: {value}" for name, value in chosen.items())
            raise ConfigError(
                f"the space has a combination that cannot be: {error} ({combination})"
            ) from None


def _values(given: ConfigNode, known: Parameter) -> tuple[Any, ...]:
    found = dict.fromkeys(item.value(known) for item in given.items or ())
    if not found:
        given.refuse(f"{known.expected}, or a list of such")
    return tuple(found)
