"""Train the network of a hybrid on the residual torque of recordings."""

from __future__ import annotations

import copy
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.features import feature_set
from estimators.hybrid import FittedNetwork, HybridModel
from estimators.neural import NETWORKS
from estimators.training_data import HELD_OUT, TRAINING, prepare
from estimators.training_gain import gain
from limo_driver.errors import ConfigError, DivergedError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from estimators.features import Features
    from estimators.neural import Network
    from estimators.neural.modules import Module
    from estimators.training_data import TrainingData
    from estimators.training_passes import Passes
    from limo_driver.physics import Simulation
    from limo_driver.recording import Recording

_PATIENCE: Final = 5  # epochs without a lower training loss before the learning rate is halved
_SCHEDULES: Final = ("cosine", "plateau")
_SLOWEST: Final = 1e-3  # of the initial learning rate; below, nothing changes any more
_WIDTHS: Final = {"mlp7": 100, "lstm-fcl": 16}  # hidden units for one joint


@dataclass(frozen=True)
class TrainingSettings:
    """How to train; the defaults are the paper's unless said."""

    model: str = "mlp7"  # mlp7 or lstm-fcl
    features: str = "all-joints"  # all-joints, own-joint or drive
    epochs: int = 100
    seed: int = 0
    bandwidth: float = 10.0  # of the filters on motion and torque [Hz]
    rate: float = 200.0  # of the network's samples [Hz]; the paper's data have 223 Hz
    sequence_length: int = 100  # samples through which a recurrent network is differentiated
    batch: int = 50  # rows of an mlp7, sequences of an lstm-fcl
    schedule: str = "cosine"  # of the learning rate; the paper has plateau
    learning_rate: float = 1e-3
    weight_decay: float = 0.01
    held_out: float = 0.2  # part of the motion
    folds: int = 3  # stretches of motion that judge how the network carries over; 1: none do
    hidden: int = 0  # units of each part; 0: 100 for mlp7, as many as inputs for one shared LSTM

    def __post_init__(self) -> None:
        if self.model not in NETWORKS:
            raise ConfigError(f"no network is called {self.model!r}; known: {', '.join(NETWORKS)}")
        if self.schedule not in _SCHEDULES:
            raise ConfigError(
                f"no schedule is called {self.schedule!r}; known: {', '.join(_SCHEDULES)}"
            )
        for name in (
            "epochs",
            "sequence_length",
            "batch",
            "bandwidth",
            "rate",
            "learning_rate",
            "folds",
        ):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} = {getattr(self, name)} has to be above 0")
        for name in ("seed", "hidden", "weight_decay"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} = {getattr(self, name)} has to be 0 or more")
        if not 0 < self.held_out < 1:
            raise ConfigError(f"held_out = {self.held_out} has to lie between 0 and 1")


def usual_settings(features: str) -> TrainingSettings:
    """Return the settings that suit a feature set: the paper's but for what follows.

    The few inputs of `drive` are learned within fewer passes and samples; more of either only teach
    the recordings by heart.
    """
    settings = TrainingSettings(features=features)
    if features == "drive":
        return replace(settings, epochs=20, rate=50.0, learning_rate=3e-3)
    return settings


@dataclass(frozen=True)
class Epoch:
    """What one pass over the training motion gave; losses are MSE of the normalised residual."""

    number: int  # from 1
    training_loss: float
    held_out_loss: float
    learning_rate: float
    fold: int = 0  # 0: of the network that is kept; else of one that judges how it carries over


def train(
    simulation: Simulation,
    recordings: Sequence[Recording],
    settings: TrainingSettings,
    on_epoch: Callable[[Epoch], None] = lambda _: None,
) -> FittedNetwork:
    """Train a network on tau_meas - tau_RBD; keep the weights that were best on held-out motion.

    After it, networks that do not see a part of the motion show how much of what is learned carries
    over to other motion: the gain of each joint.

    The loss is the MSE of the normalised residual, so that every joint counts the same. AdamW
    starts at `learning_rate`, which falls to zero along a cosine, or is halved when the training
    loss stops falling. A recurrent
    network answers every sample of a sequence, not only the last, and its memory is carried from
    a sequence to the next: it is trained as it is used, scanning long motion, and each sequence
    gives as many targets as it has samples.

    Args:
        simulation: Gives tau_RBD.
        recordings: Measured motion and torque, at about one rate.
        settings: How to train.
        on_epoch: Called after each epoch, for a progress bar.

    Raises:
        ConfigError: A setting names nothing known.
        RecordingError: A recording is of another robot, or too short for a sequence.
        DivergedError: The loss is no longer finite.

    Source: Çallar and Böttger, RA-L 2022, sec. III-D, whose recurrent networks answer only the last
    sample of each sequence.
    """
    features = feature_set(settings.features, simulation.model.n)
    random = np.random.default_rng(settings.seed)
    data = prepare(
        simulation,
        recordings,
        features,
        bandwidth=settings.bandwidth,
        rate=settings.rate,
        held_out=settings.held_out,
        random=random,
    )
    with _reproducible(settings.seed):
        network, history = _fit(data, features, settings, on_epoch)
        gains = gain(
            data,
            settings.folds,
            lambda rest, fold: _fit(rest, features, settings, on_epoch, fold)[0],
        )
    fitted = FittedNetwork(
        features,
        network,
        data.input_scaling,
        data.output_scaling,
        gains,
        data.rate,
        settings.bandwidth,
    )
    record = {
        "settings": asdict(settings),
        "recordings": [_provenance(recording) for recording in recordings],
        "rmse": _rmse(simulation, fitted, recordings, data),
        "epochs": [asdict(epoch) for epoch in history],
    }
    return replace(fitted, record=record)


def _provenance(recording: Recording) -> dict[str, Any]:
    path = Path(recording.source)
    readable = bool(recording.source) and path.is_file()
    return {
        "file": path.name,
        "sha256": sha256(path.read_bytes()).hexdigest() if readable else None,
        "samples": len(recording),
        "left_out": sum(len(item.rows) for item in recording.left_out),
    }


def _rmse(
    simulation: Simulation,
    fitted: FittedNetwork,
    recordings: Sequence[Recording],
    data: TrainingData,
) -> dict[str, dict[str, list[float]]]:
    """Return RMSE per joint [N m] of rigid body and hybrid, as they are used: scanning it all."""
    model = HybridModel(simulation)
    model.fitted_ = fitted
    parts = [model.parts(recording) for recording in recordings]
    torque = np.concatenate([r.filtered_torque(fitted.bandwidth) for r in recordings])
    predicted = {
        "rigid_body": np.concatenate([part.rigid_body for part in parts]),
        "hybrid": np.concatenate([part.hybrid for part in parts]),
    }
    rows = {"training": data.use == TRAINING, "held_out": data.use == HELD_OUT}
    return {
        where: {
            name: np.sqrt(np.mean((torque - values)[use] ** 2, axis=0)).tolist()
            for name, values in predicted.items()
        }
        for where, use in rows.items()
    }


@contextmanager
def _reproducible(seed: int) -> Generator[None]:
    """Seed PyTorch and keep it on one thread, which is faster here; restore both after."""
    import torch

    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def _build(settings: TrainingSettings, features: Features) -> Module:
    from estimators.neural.modules import LstmModule, MlpModule

    columns = features.columns
    if settings.model == "mlp7":
        return MlpModule(columns, settings.hidden or _WIDTHS["mlp7"], 1)
    if features.own_joint:
        return LstmModule(columns, settings.hidden or _WIDTHS["lstm-fcl"], 1)
    return LstmModule(columns[:1], settings.hidden or columns.shape[1], features.n)


def _fit(
    data: TrainingData,
    features: Features,
    settings: TrainingSettings,
    on_epoch: Callable[[Epoch], None],
    fold: int = 0,
) -> tuple[Network, list[Epoch]]:
    """Train a network on the data of a fold."""
    module = _build(settings, features)
    passes = _passes(settings, data, np.random.default_rng(settings.seed))
    history = _descend(module, passes, settings, lambda epoch: on_epoch(replace(epoch, fold=fold)))
    return NETWORKS[settings.model](module.columns_of_parts(), module.weights()), history


def _passes(settings: TrainingSettings, data: TrainingData, random: np.random.Generator) -> Passes:
    from estimators.training_passes import RowPasses, SequencePasses

    if NETWORKS[settings.model].recurrent:
        return SequencePasses(data, settings.batch, random, settings.sequence_length)
    return RowPasses(data, settings.batch, random)


def _descend(
    module: Module, passes: Passes, settings: TrainingSettings, on_epoch: Callable[[Epoch], None]
) -> list[Epoch]:
    """Run the epochs and leave the best weights in the module."""
    import torch

    optimizer = torch.optim.AdamW(
        module.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay
    )
    cosine = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.epochs)
    plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(optimizer, factor=0.5, patience=_PATIENCE)
    best, weights = np.inf, copy.deepcopy(module.state_dict())
    history: list[Epoch] = []
    judged = bool((passes.data.use == HELD_OUT).any())  # a fold of a short recording may have none
    for number in range(1, settings.epochs + 1):
        rate = float(optimizer.param_groups[0]["lr"])
        if settings.schedule == "plateau" and rate < _SLOWEST * settings.learning_rate:
            break
        epoch = Epoch(number, *passes.epoch(module, optimizer), rate)
        if not np.isfinite([epoch.training_loss, epoch.held_out_loss]).all():
            raise DivergedError(
                f"the loss is no longer finite in epoch {number}; lower the learning rate "
                f"({settings.learning_rate:g}) or look for outliers in the torque"
            )
        history.append(epoch)
        on_epoch(epoch)
        if settings.schedule == "cosine":
            cosine.step()
        else:
            plateau.step(epoch.training_loss)
        loss = epoch.held_out_loss if judged else epoch.training_loss
        if loss < best:
            best, weights = loss, copy.deepcopy(module.state_dict())
    module.load_state_dict(weights)
    return history
