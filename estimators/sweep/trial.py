"""A trial of a sweep: its settings, and how the network that they gave is judged."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from json import dumps
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.hybrid import HybridModel
from estimators.hybrid.training.data import prepare
from estimators.hybrid.training.split import LEFT_OUT
from limo_driver.runtime.kept_results import KeptResults

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from estimators.hybrid.fitted_network import FittedNetwork
    from estimators.hybrid.training.settings import TrainingSettings
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

MODEL: Final = "model"  # folder of a trial's model, as `limo train` writes it
_DIGITS: Final = 24  # of a key: 96 bits


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
