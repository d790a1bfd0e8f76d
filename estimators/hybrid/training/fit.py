"""Train the network of a hybrid on the residual torque of recordings."""

from __future__ import annotations

import copy
import json
import pickle
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.hybrid.fitted_network import FittedNetwork
from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, TrainingData
from estimators.hybrid.training.settings import DEVICES, WIDTHS, TrainingSettings, require_torch
from estimators.neural import NETWORKS, Network
from limo_driver.errors import ConfigError, DivergedError
from limo_driver.runtime.outputs import whole

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator
    from pathlib import Path

    import torch

    from estimators.hybrid.features import Features
    from estimators.hybrid.training.passes import Passes
    from estimators.neural.modules import Module
    from limo_driver.types import BoolArray, FloatArray

_PATIENCE: Final = 5  # epochs without a lower training loss before the learning rate is halved
_SLOWEST: Final = 1e-3  # of the initial learning rate; below, nothing changes any more


@dataclass(frozen=True)
class Epoch:
    """Result of one pass over the training motion; losses are MSE of the normalised residual."""

    number: int  # from 1
    training_loss: float
    held_out_loss: float
    learning_rate: float
    fold: int = 0  # 0: of the network that is kept; else of one that judges how it carries over


def fit_prepared(
    data: TrainingData,
    settings: TrainingSettings,
    on_epoch: Callable[[Epoch], None] = lambda _: None,
    unfinished: Path | None = None,
) -> FittedNetwork:
    """Train a network on data that are prepared already; as `train`, but without its errors.

    Args:
        data: What `prepare` gives for these settings.
        settings: How to train.
        on_epoch: Called after each epoch.
        unfinished: Folder in which each epoch is kept, to go on from after a kill.

    Raises:
        ConfigError: The device is not there, or what was kept cannot be read.
        RecordingError: No stretch is as long as a sequence.
        DivergedError: The loss is no longer finite.
    """
    device = device_for(settings)
    features = settings.features_for(data.targets.shape[1])

    def fit(seen: TrainingData, fold: int = 0) -> tuple[Network, list[Epoch]]:
        """Train a network on the data of a fold."""
        module = _build(settings, features).to(device)
        passes = _passes(settings, seen, device)
        kept = None if unfinished is None else unfinished / f"fold{fold}.pt"
        training = _Training(module, passes, settings, fold, kept)
        history = training.run(on_epoch)
        return NETWORKS[settings.model](module.columns_of_parts(), module.weights()), history

    with _reproducible(settings.seed, device):
        network, history = fit(data)
        carried = carry_over(data, settings.folds, lambda rest, fold: fit(rest, fold)[0])
    left_out = {"hybrid": carried.rmse.tolist()}
    return FittedNetwork(
        features,
        network,
        data.input_scaling,
        data.output_scaling,
        carried.gain,
        data.rate,
        settings.bandwidth,
        record={
            "settings": asdict(settings),
            "device": str(device),
            "epochs": [asdict(epoch) for epoch in history],
            **({} if np.isnan(carried.rmse).any() else {"rmse": {"left_out": left_out}}),
        },
        standalone=settings.standalone,
    )


def device_for(settings: TrainingSettings) -> torch.device:
    """Return where to train a network; one without memory is always trained on the CPU.

    Its steps are so small that a GPU mostly waits for the next: an H100 took 12 times as long.

    Raises:
        ConfigError: The device is not there.
    """
    found = find_device(settings.device)
    return found if NETWORKS[settings.model].recurrent else find_device("cpu")


def find_device(name: str) -> torch.device:
    """Return where to train: a GPU where PyTorch sees one, unless told otherwise.

    Raises:
        ConfigError: The name is unknown, or the device is not there.
        MissingPackageError: PyTorch is not installed.
    """
    if name not in DEVICES:
        raise ConfigError(f"no device is called {name!r}; known: {', '.join(DEVICES)}")
    require_torch()
    import torch

    found = torch.cuda.is_available()
    if name == "cuda" and not found:
        raise ConfigError("device: PyTorch sees no CUDA device; take auto or cpu")
    return torch.device("cuda" if found and name != "cpu" else "cpu")


@contextmanager
def _reproducible(seed: int, device: torch.device) -> Generator[None]:
    """Seed PyTorch and keep it on one thread, which is faster here; restore both after."""
    import torch

    threads = torch.get_num_threads()
    gpus = [torch.cuda.current_device()] if device.type == "cuda" else []
    with torch.random.fork_rng(devices=gpus):
        torch.manual_seed(seed)
        torch.set_num_threads(1)
        try:
            yield
        finally:
            torch.set_num_threads(threads)


def _build(settings: TrainingSettings, features: Features) -> Module:
    from estimators.neural import modules

    columns, outputs = features.columns, 1
    hidden = settings.hidden or WIDTHS[settings.model]
    if settings.model == "mlp7":
        return modules.MlpModule(columns, hidden, outputs)
    if not features.own_joint:  # one network for all joints
        outputs, columns = features.n, columns[:1]
    if settings.model == "transformer":
        size = settings.sequence_length, hidden, settings.layers, settings.heads
        return modules.TransformerModule(columns, outputs, *size)
    if not features.own_joint:
        hidden = settings.hidden or columns.shape[1]
    if settings.model == "lstm-2":
        return modules.LstmModule(columns, (hidden, outputs))
    if settings.model == "lru":
        return modules.LruModule(columns, hidden, hidden, outputs)
    cells = modules.GruModule if settings.model == "gru" else modules.LstmFclModule
    return cells(columns, hidden, outputs, settings.layers)


def _passes(settings: TrainingSettings, data: TrainingData, device: torch.device) -> Passes:
    from estimators.hybrid.training.passes import BlockPasses, RowPasses, SequencePasses

    random = np.random.default_rng(settings.seed)
    if not NETWORKS[settings.model].recurrent:
        return RowPasses(data, settings.batch, random, device)
    passes = BlockPasses if settings.model == "transformer" else SequencePasses
    return passes(data, settings.batch, random, device, settings.sequence_length, settings.carried)


class _Training:
    """The epochs of one network, each of which is kept in a file, to go on from after a kill."""

    def __init__(
        self,
        module: Module,
        passes: Passes,
        settings: TrainingSettings,
        fold: int,
        kept: Path | None,
    ) -> None:
        import torch

        self.module, self.passes, self.settings, self.kept = module, passes, settings, kept
        self.fold = fold
        self.optimizer = torch.optim.AdamW(
            module.parameters(),
            lr=settings.learning_rate,
            weight_decay=settings.weight_decay,
            fused=True,  # one pass over each weight; a step of a small network is all overhead
        )
        self.plateau = torch.optim.lr_scheduler.ReduceLROnPlateau(
            self.optimizer, factor=0.5, patience=_PATIENCE
        )
        self.parts = {"module": module, "optimizer": self.optimizer, "plateau": self.plateau}
        self.history: list[Epoch] = []
        self.best, self.best_epoch, self.weights = np.inf, 0, copy.deepcopy(module.state_dict())

    def run(self, on_epoch: Callable[[Epoch], None]) -> list[Epoch]:
        """Run the epochs that are left; leave the weights in the module that are to be kept."""
        settings, seen = self.settings, self.passes.data.use
        judged = bool((seen == HELD_OUT).any())  # a fold of a short recording may have none
        self._go_on()
        for epoch in self.history:
            on_epoch(epoch)
        for number in range(len(self.history) + 1, settings.epochs + 1):
            rate = float(self.optimizer.param_groups[0]["lr"])
            if settings.schedule == "plateau" and rate < _SLOWEST * settings.learning_rate:
                break
            if 0 < settings.patience < number - self.best_epoch:
                break
            losses = self.passes.epoch(self.module, self.optimizer)
            if not np.isfinite(losses).all():
                raise DivergedError(
                    f"the loss is no longer finite in epoch {number}; lower the learning rate "
                    f"({settings.learning_rate:g}) or look for outliers in the torque"
                )
            epoch = Epoch(number, *losses, rate, self.fold)
            self.history.append(epoch)
            if settings.schedule == "cosine":
                cosine = (1.0 + np.cos(np.pi * number / settings.epochs)) / 2.0
                self.optimizer.param_groups[0]["lr"] = float(settings.learning_rate * cosine)
            else:
                self.plateau.step(epoch.training_loss)
            loss = epoch.held_out_loss if judged else epoch.training_loss
            better = loss < self.best
            if better:
                self.best, self.best_epoch = loss, number
            if better or settings.keep == "last":
                self.weights = copy.deepcopy(self.module.state_dict())
            self._keep()
            on_epoch(epoch)
        self.module.load_state_dict(self.weights)
        return self.history

    @cached_property
    def _identity(self) -> str:
        """Return a digest of settings and data: what another training left is not gone on from."""
        data = self.passes.data
        digest = sha256(repr(replace(self.settings, device="auto")).encode())
        for values in (data.inputs, data.targets, data.use):
            digest.update(values.tobytes())
        return digest.hexdigest()

    def _keep(self) -> None:
        import torch

        if self.kept is None:
            return
        values = {
            **{name: part.state_dict() for name, part in self.parts.items()},
            "identity": self._identity,
            "random": json.dumps(self.passes.random.bit_generator.state),
            "given": self.passes.memory,
            "history": [asdict(epoch) for epoch in self.history],
            "best": (float(self.best), self.best_epoch),
            "weights": self.weights,
        }
        self.kept.parent.mkdir(parents=True, exist_ok=True)
        with whole(self.kept) as draft:
            torch.save(values, draft)

    def _go_on(self) -> None:
        """Take up what was kept of this training, if anything was."""
        import torch

        if self.kept is None or not self.kept.exists():
            return
        try:
            values = torch.load(self.kept, map_location=self.passes.device, weights_only=True)
            if values["identity"] != self._identity:
                return
            for name, part in self.parts.items():
                part.load_state_dict(values[name])
            self.passes.random.bit_generator.state = json.loads(values["random"])
            for own, known in zip(self.passes.memory, values["given"], strict=True):
                own.copy_(known)
            self.history = [Epoch(**epoch) for epoch in values["history"]]
            (self.best, self.best_epoch), self.weights = values["best"], values["weights"]
        except (OSError, EOFError, RuntimeError, LookupError, TypeError, ValueError,
                pickle.UnpicklingError):  # fmt: skip
            raise ConfigError(
                "cannot be read as an unfinished training; delete it to begin anew",
                path=self.kept,
            ) from None


@dataclass(frozen=True)
class CarryOver:
    """Part of a network's torque that carries over, and the error that remains then."""

    gain: FloatArray  # (n,) in [0, 1], without unit
    rmse: FloatArray  # (n,) [N m], of g F_NN on stretches left out; NaN if none was


def carry_over(
    data: TrainingData, folds: int, fit: Callable[[TrainingData, int], Network]
) -> CarryOver:
    """Find for each joint the part of the network's torque that motion not trained on confirms.

    The motion is cut into whole stretches. For each in turn, a network that learned from the others
    predicts the residual there. The gain minimises the squared error of g F_NN over all of them,

        g = <residual, F_NN> / <F_NN, F_NN>, within [0, 1],

    so that a network that learned the recordings by heart is switched off instead of doing harm.
    Blocks of seconds would not tell: their neighbours, which are alike, were trained on, and they
    choose which weights are kept. So the errors of these predictions are also what says how sure
    the network is.

    Args:
        data: All rows.
        folds: Stretches; with 1, the gain is not looked for and is 1.
        fit: Trains a network on the data of a fold, which is counted from 1.
    """
    n = data.targets.shape[1]
    if folds == 1:
        return CarryOver(np.ones(n), np.full(n, np.nan))
    product, square, energy, count = np.zeros(n), np.zeros(n), np.zeros(n), 0
    for number, rows in enumerate(_folds(data, folds), start=1):
        rest, judged = _without(data, rows), rows & (data.use != LEFT_OUT)
        if not judged.any() or not (rest.use == TRAINING).any():
            continue
        predicted = data.output_scaling.restore(_scan(rest, fit(rest, number)))[judged]
        residual = data.output_scaling.restore(data.targets[judged].astype(np.float64))
        product += np.sum(residual * predicted, axis=0)
        square += np.sum(predicted**2, axis=0)
        energy += np.sum(residual**2, axis=0)
        count += len(residual)
    gain = np.clip(np.divide(product, square, out=np.zeros(n), where=square > 0), 0.0, 1.0)
    error = np.maximum(energy - 2 * gain * product + gain**2 * square, 0.0)
    return CarryOver(gain, np.sqrt(error / count) if count else np.full(n, np.nan))


def _folds(data: TrainingData, folds: int) -> Iterator[BoolArray]:
    """Give the rows of each fold: whole recordings when there are enough, else parts of each."""
    fold = np.empty(len(data.use), np.int64)
    for i, rows in enumerate(data.recordings):
        length = rows.stop - rows.start
        several = len(data.recordings) >= folds
        fold[rows] = i % folds if several else np.arange(length) * folds // length
    for number in range(folds):
        yield fold == number


def _without(data: TrainingData, rows: BoolArray) -> TrainingData:
    """Leave rows out, and clip all inputs to the range that is left."""
    use = np.where(rows, LEFT_OUT, data.use).astype(np.int8)
    seen = data.inputs[use == TRAINING]
    if not seen.size:
        return replace(data, use=use)
    inputs = np.clip(data.inputs, seen.min(axis=0), seen.max(axis=0))
    return replace(data, inputs=inputs, use=use)


def _scan(data: TrainingData, network: Network) -> FloatArray:
    """Predict all rows, (T, n), normalised; memory is reset at the start of each stretch."""
    y = np.empty(data.targets.shape)
    for rows in data.stretches:
        memory = network.init(data.stride)
        y[rows], _ = network.advance(memory, data.inputs[rows].astype(np.float64))
    return y
