"""An epoch of perceptrons against PyTorch's own steps, and its learning rate."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from lanes import sampled

from estimators.hybrid.features import feature_set
from estimators.hybrid.fitted_network import InputScaling, Scaling
from estimators.hybrid.model import train
from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, TrainingData
from estimators.hybrid.training.passes import RowPasses
from estimators.hybrid.training.settings import TrainingSettings
from estimators.neural.modules import MlpModule

if TYPE_CHECKING:
    from estimators.hybrid.training.fit import Epoch
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

ROWS, BATCH, JOINTS = 6010, 50, 7  # about 100 batches an epoch, the last of which is smaller
RATES = (1e-3, 5e-4)  # of two epochs
CPU = torch.device("cpu")


def motion(inputs: int, outputs: int, size: float = 1.0) -> TrainingData:
    """Return rows that a perceptron can learn, with targets of a size."""
    random = np.random.default_rng(0)
    x = random.standard_normal((ROWS, inputs)).astype(np.float32)
    y = np.tanh(2.0 * x[:, :outputs]) + 0.1 * random.standard_normal((ROWS, outputs))
    return TrainingData(
        inputs=x,
        targets=(size * y).astype(np.float32),
        use=random.choice([TRAINING, HELD_OUT, LEFT_OUT], ROWS, p=[0.85, 0.1, 0.05]),
        stretches=(slice(0, ROWS),),
        recordings=(slice(0, ROWS),),
        input_scaling=InputScaling.of(x),
        output_scaling=Scaling.of(y),
        stride=1,
        rate=100.0,
    )


def perceptron(features: str, outputs: int = 1) -> MlpModule:
    torch.manual_seed(0)
    return MlpModule(feature_set(features, JOINTS).columns, 100, outputs)


def adam(module: MlpModule) -> torch.optim.Optimizer:
    return torch.optim.AdamW(module.parameters(), lr=RATES[0], weight_decay=0.01)


def plain(
    module: MlpModule, optimizer: torch.optim.Optimizer, data: TrainingData
) -> list[tuple[float, float]]:
    """Train as PyTorch's documentation does, step by step; return both losses of each epoch."""
    random, losses = np.random.default_rng(1), []
    inputs, targets = torch.from_numpy(data.inputs), torch.from_numpy(data.targets)
    for rate in RATES:
        optimizer.param_groups[0]["lr"] = rate
        random.integers(data.stride)
        order = random.permutation(np.flatnonzero(data.use == TRAINING))
        total = 0.0
        for rows in torch.from_numpy(order).split(BATCH):
            optimizer.zero_grad()
            loss = torch.nn.functional.mse_loss(module(inputs[rows]), targets[rows])
            loss.backward()
            torch.nn.utils.clip_grad_norm_(module.parameters(), 1.0)
            optimizer.step()
            total += float(loss.detach()) * len(rows)
        out = torch.from_numpy(np.flatnonzero(data.use == HELD_OUT))
        with torch.no_grad():
            held_out = torch.nn.functional.mse_loss(module(inputs[out]), targets[out])
        losses.append((total / len(order), float(held_out)))
    return losses


def distance(found: torch.Tensor, expected: torch.Tensor) -> float:
    """Return how far two arrays are apart, relative to the size of the second."""
    return float(((found - expected).norm() / expected.norm()).detach())


@sampled(
    ("features", "outputs", "size"),
    [("all-joints", 1, 1.0), ("own-joint", 1, 1.0), ("drive", 2, 1.0), ("all-joints", 1, 10.0)],
    "trains a network each",
    ids=["same inputs", "own joint", "two outputs a part", "every gradient clipped"],
)
def test_an_epoch_is_that_of_a_plain_loop(features: str, outputs: int, size: float) -> None:
    expected = perceptron(features, outputs)
    module = copy.deepcopy(expected)
    data = motion(int(expected.columns_of_parts().max()) + 1, JOINTS * outputs, size)
    by_torch, optimizer = adam(expected), adam(module)
    losses = plain(expected, by_torch, data)

    passes = RowPasses(data, BATCH, np.random.default_rng(1), CPU)
    for rate, loss in zip(RATES, losses, strict=True):
        optimizer.param_groups[0]["lr"] = rate
        assert passes.epoch(module, optimizer) == pytest.approx(loss, rel=1e-4)
    for found, reference in zip(module.parameters(), expected.parameters(), strict=True):
        assert distance(found, reference) < 1e-4
        state, of_torch = optimizer.state[found], by_torch.state[reference]
        assert state["step"] == of_torch["step"]
        for moment in ("exp_avg", "exp_avg_sq"):
            assert distance(state[moment], of_torch[moment]) < 1e-3  # of a sum that nearly cancels


@pytest.mark.parametrize("column", [0, 34])
def test_a_row_that_is_no_number_shows_in_the_loss(column: int) -> None:
    data = motion(35, JOINTS)
    data.inputs[np.flatnonzero(data.use == TRAINING)[0], column] = np.nan
    module = perceptron("all-joints")
    passes = RowPasses(data, BATCH, np.random.default_rng(1), CPU)
    assert np.isnan(passes.epoch(module, adam(module))).all()


def test_fewer_rows_than_a_batch() -> None:
    data = motion(35, JOINTS)
    few = replace(data, use=np.where(np.arange(ROWS) < BATCH // 2, TRAINING, LEFT_OUT))
    module = perceptron("all-joints")
    before = copy.deepcopy(module.weights())
    passes = RowPasses(few, BATCH, np.random.default_rng(1), CPU)
    optimizer = adam(module)
    training, held_out = passes.epoch(module, optimizer)
    rows = slice(BATCH // 2)
    initial = perceptron("all-joints")(torch.from_numpy(data.inputs[rows])).detach().numpy()
    assert training == pytest.approx(np.mean((initial - data.targets[rows]) ** 2), rel=1e-5)
    assert held_out == 0.0  # there is none
    assert {float(state["step"]) for state in optimizer.state.values()} == {1.0}
    assert all((before[name] != after).any() for name, after in module.weights().items())


def test_the_learning_rate_falls_along_a_cosine(
    rigid: Simulation, training_recording: Recording
) -> None:
    settings = TrainingSettings(features="own-joint", epochs=7, rate=50.0, hidden=4, folds=1)
    seen: list[Epoch] = []
    train(rigid, [training_recording], settings, seen.append)
    optimizer = torch.optim.AdamW([torch.zeros(1)], lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, settings.epochs)
    for epoch in seen:
        assert epoch.learning_rate == pytest.approx(schedule.get_last_lr()[0], rel=1e-9)
        optimizer.step()
        schedule.step()
