"""One pass over the training motion for a perceptron on a CPU, compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch
from threadpoolctl import ThreadpoolController

from estimators.hybrid.training.passes import LARGEST_GRADIENT, RowPasses
from estimators.neural.mlp_descent import AdamW, descend, mean_square

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from torch import Tensor

    from estimators.hybrid.training.data import TrainingData
    from estimators.neural.modules import Module

_WEIGHTS: Final = ("hidden_weight", "hidden_bias", "output_weight", "output_bias")
_MOMENTS: Final = ("exp_avg", "exp_avg_sq")


class CompiledRowPasses(RowPasses):
    """For perceptrons on a CPU; leaves module and optimizer as PyTorch's own steps would."""

    def __init__(
        self, data: TrainingData, batch: int, random: np.random.Generator, device: torch.device
    ) -> None:
        super().__init__(data, batch, random, device)
        self.pools = ThreadpoolController()

    def epoch(self, module: Module, optimizer: torch.optim.Optimizer) -> tuple[float, float]:
        """Train on shuffled rows, then evaluate the held-out ones."""
        data = self.data
        parameters = [module.get_parameter(name) for name in _WEIGHTS]
        states = [_state(optimizer, parameter) for parameter in parameters]
        weights = tuple(_flat(parameter) for parameter in parameters)
        moments = tuple(tuple(_flat(state[name]) for state in states) for name in _MOMENTS)
        fixed = data.inputs, data.targets, module.columns_of_parts(), weights
        constants = _constants(optimizer)

        def train(batches: NDArray[np.int64]) -> float:
            loss = descend(*fixed, batches, moments, int(states[0]["step"]), constants)
            for state in states:
                state["step"] += len(batches)
            return loss

        with self.pools.limit(limits=1, user_api="blas"):  # such products are not worth sharing out
            training = self._mean(self.shuffled(), train)
            return training, self._mean(self.held_out, lambda rows: mean_square(*fixed, rows))

    def _mean(self, rows: NDArray[np.int64], loss: Callable[[NDArray[np.int64]], float]) -> float:
        """Return the mean of the loss over all rows in whole batches, and the rest in one."""
        rows = np.ascontiguousarray(rows)  # others would be compiled for, too
        whole = len(rows) // self.batch * self.batch
        pieces = rows[:whole].reshape(-1, self.batch), rows[whole:].reshape(1, -1)
        total = sum(loss(piece) * piece.size for piece in pieces if piece.size)
        return total / max(len(rows), 1)


def _constants(optimizer: torch.optim.Optimizer) -> AdamW:
    group = optimizer.param_groups[0]
    return AdamW(
        learning_rate=float(group["lr"]),
        weight_decay=float(group["weight_decay"]),
        beta1=float(group["betas"][0]),
        beta2=float(group["betas"][1]),
        epsilon=float(group["eps"]),
        largest_gradient=LARGEST_GRADIENT,
    )


def _state(optimizer: torch.optim.Optimizer, parameter: Tensor) -> dict[str, Any]:
    """Return the state that AdamW has for a parameter; before its first step, all zero."""
    state = optimizer.state[parameter]
    if not state:
        state["step"] = torch.zeros(())
        for name in _MOMENTS:
            state[name] = torch.zeros_like(parameter)
    return state


def _flat(values: Tensor) -> NDArray[np.float32]:
    """Return the memory of a tensor as an array."""
    return values.detach().view(-1).numpy()
