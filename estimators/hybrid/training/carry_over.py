"""Estimate how much of a network's torque carries over to motion it was not trained on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.hybrid.training.split import LEFT_OUT, TRAINING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from estimators.hybrid.training.data import TrainingData
    from estimators.neural import Network
    from limo_driver.types import FloatArray


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


def _folds(data: TrainingData, folds: int) -> Iterator[NDArray[np.bool_]]:
    """Give the rows of each fold: whole recordings when there are enough, else parts of each."""
    fold = np.empty(len(data.use), np.int64)
    for i, rows in enumerate(data.recordings):
        length = rows.stop - rows.start
        several = len(data.recordings) >= folds
        fold[rows] = i % folds if several else np.arange(length) * folds // length
    for number in range(folds):
        yield fold == number


def _without(data: TrainingData, rows: NDArray[np.bool_]) -> TrainingData:
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
