"""One pass over the training motion: by rows for a perceptron, by sequences for an LSTM."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch
from threadpoolctl import ThreadpoolController

from estimators.hybrid.training.data import HELD_OUT, LEFT_OUT, TRAINING, TrainingData
from estimators.neural.mlp import AdamW, descend, mean_square
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray
    from torch import Tensor

    from estimators.neural.modules import Memory, Module
    from limo_driver.types import BoolArray, IntArray

_FEWEST_CHUNKS: Final = 4  # in the longest stretch, even of a short recording
LARGEST_GRADIENT: Final = 1.0  # norm
_WEIGHTS: Final = ("hidden_weight", "hidden_bias", "output_weight", "output_bias")
_MOMENTS: Final = ("exp_avg", "exp_avg_sq")


def _mean(found: list[tuple[Tensor, int]]) -> float:
    """Return the mean of means by their counts, for which the device is waited for once."""
    known = [(mean, count) for mean, count in found if count]
    if not known:
        return 0.0
    means, counts = zip(*known, strict=True)
    return float(np.average(torch.stack(means).cpu().numpy(), weights=counts))


class Passes(ABC):
    """Goes over the training motion once in an epoch, in a new order each time.

    Args:
        data: Inputs, targets and who sees which rows.
        batch: Rows, or sequences, of one step of the optimiser.
        random: Draws the order.
        device: Where the data lie while training.
    """

    def __init__(
        self, data: TrainingData, batch: int, random: np.random.Generator, device: torch.device
    ) -> None:
        self.data, self.batch, self.random, self.device = data, batch, random, device
        self.inputs = torch.from_numpy(data.inputs).to(device)
        self.targets = torch.from_numpy(data.targets).to(device)

    @property
    def memory(self) -> list[Tensor]:
        """What an epoch hands on to the next, besides weights and random state."""
        return []

    @abstractmethod
    def epoch(self, module: Module, optimizer: torch.optim.Optimizer) -> tuple[float, float]:
        """Train for one pass; return training and held-out loss."""

    def _phase(self) -> int:
        """Draw which of every `stride` rows are used: each epoch sees others."""
        return int(self.random.integers(self.data.stride))

    def _on_device(self, values: IntArray) -> Tensor:
        return torch.from_numpy(values).to(self.device)


class SequencePasses(Passes):
    """For networks with memory: chunks of several sequences, whose memory is carried along.

    The network scans a whole chunk, held-out motion included, as it will in use; the loss is taken
    at training rows only. Chunks without any training row are evaluated after the others. Those of
    several sequences start at other rows in each epoch; single sequences are always the same, and
    are those that a split by sequences holds out.

    Args:
        data: Inputs, targets and who sees which rows.
        batch: Sequences of one step of the optimiser.
        random: Draws the order.
        device: Where the data lie while training.
        length: Samples of a sequence.
        carried: Sequences of a chunk.

    Raises:
        RecordingError: No stretch is as long as a sequence.
    """

    def __init__(
        self,
        data: TrainingData,
        batch: int,
        random: np.random.Generator,
        device: torch.device,
        length: int,
        carried: int,
    ) -> None:
        super().__init__(data, batch, random, device)
        self.length = length
        self.fixed = carried == 1
        self.stretches = [self._sure(rows) for rows in data.stretches]
        longest = max((rows.stop - rows.start) // data.stride for rows in self.stretches)
        if longest < length:
            raise RecordingError(
                f"the longest stretch without a gap has {longest} samples at {data.rate:.4g} Hz "
                f"({longest / data.rate:.3g} s), but a sequence needs {length}; record longer "
                "motion or ask for shorter sequences"
            )
        self.chunk = max(1, min(carried, longest // (length * _FEWEST_CHUNKS))) * length

    def epoch(self, module: Module, optimizer: torch.optim.Optimizer) -> tuple[float, float]:
        """Train on shuffled chunks, then evaluate those that are held out whole."""
        starts = self.random.permutation(self._starts())
        rows = starts[:, None] + self.data.stride * np.arange(self.chunk)
        trained = (self.data.use[rows] == TRAINING).any(axis=1)
        training: list[tuple[Tensor, int]] = []
        held_out: list[tuple[Tensor, int]] = []
        for squares, use in self._scan(module, rows[trained]):
            loss, count = _mean_at(squares, use == TRAINING)
            if count:
                _descend(loss, module, optimizer)
                training.append((loss.detach(), count))
            held_out.append(_mean_at(squares.detach(), use == HELD_OUT))
        with torch.no_grad():
            for squares, use in self._scan(module, rows[~trained]):
                held_out.append(_mean_at(squares, use == HELD_OUT))
        return _mean(training), _mean(held_out)

    def _scan(self, module: Module, rows: IntArray) -> Iterator[tuple[Tensor, NDArray[np.int8]]]:
        """Give the squared errors (B, length, n) of each batch and sequence, and who sees which."""
        for first in range(0, len(rows), self.batch):
            batch, memory = rows[first : first + self.batch], None
            for start in range(0, self.chunk, self.length):
                part = batch[:, start : start + self.length]
                predicted, memory = self._predict(module, part, memory)
                yield (predicted - self._gather(self.targets, part)) ** 2, self.data.use[part]

    def _predict(self, module: Module, rows: IntArray, memory: Memory) -> tuple[Tensor, Memory]:
        """Give the outputs (B, length, n) for rows (B, length) and the memory after them."""
        return module(self._gather(self.inputs, rows), memory)

    def _gather(self, values: Tensor, rows: IntArray) -> Tensor:
        """Return (B, length, d); `index_select` copies whole rows, which indexing does not."""
        flat = values.index_select(0, self._on_device(rows.reshape(-1)))
        return flat.reshape(*rows.shape, values.shape[1])

    def _sure(self, rows: slice) -> slice:
        """Leave out the ends of a stretch that no sequence of a fixed division may reach into."""
        if not self.fixed:
            return rows
        used = np.flatnonzero(self.data.use[rows] != LEFT_OUT)
        if not used.size:
            return slice(rows.start, rows.start)
        return slice(rows.start + int(used[0]), rows.start + int(used[-1]) + 1)

    def _starts(self) -> IntArray:
        """Cut each stretch into chunks, from a random row on unless they are fixed."""
        span = self.chunk * self.data.stride
        starts: list[IntArray] = []
        for rows in self.stretches:
            spare = rows.stop - rows.start - span
            if spare >= 0:
                shift = 0 if self.fixed else int(self.random.integers(min(spare, span - 1) + 1))
                starts.append(np.arange(rows.start + shift, rows.stop - span + 1, span))
        return np.concatenate(starts) + (self._phase() if self.fixed else 0)


class BlockPasses(SequencePasses):
    """For a transformer, which starts anew in each sequence and is shown its previous outputs.

    In use these are its own. In training they are what it gave for the same rows in the epoch
    before, from zeros in the first: nothing has to be computed twice, and the closer it comes to
    rest, the closer this is to use. Shown the measured torque instead, which hardly changes from a
    sample to the next, it would learn to repeat it, and drift away on its own outputs.
    """

    @cached_property
    def given(self) -> Tensor:
        """Its output for each row in the epoch before, (T, n); written to as it goes."""
        return torch.zeros_like(self.targets)

    @property
    def memory(self) -> list[Tensor]:
        """The outputs of the epoch before."""
        return [self.given]

    def _predict(
        self,
        module: Module,
        rows: IntArray,
        memory: Memory,  # noqa: ARG002  # starts anew
    ) -> tuple[Tensor, Memory]:
        before = torch.nn.functional.pad(self._gather(self.given, rows)[:, :-1], (0, 0, 1, 0))
        y = module(self._gather(self.inputs, rows), before)
        self.given.index_copy_(0, self._on_device(rows.reshape(-1)), y.detach().flatten(0, 1))
        return y, None


def _mean_at(squares: Tensor, where: BoolArray) -> tuple[Tensor, int]:
    """Return the mean of squares (B, T, n) over the samples (B, T) that count, and how many do."""
    count = int(where.sum())
    if count == where.size:
        return squares.mean(), count
    weights = torch.from_numpy(where.astype(np.float32) / max(count, 1)).to(squares.device)
    return (squares.mean(dim=-1) * weights).sum(), count


def _descend(loss: Tensor, module: Module, optimizer: torch.optim.Optimizer) -> None:
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(module.parameters(), LARGEST_GRADIENT)
    optimizer.step()


class RowPasses(Passes):
    """For perceptrons on a CPU; leaves module and optimizer as PyTorch's own steps would."""

    def __init__(
        self, data: TrainingData, batch: int, random: np.random.Generator, device: torch.device
    ) -> None:
        super().__init__(data, batch, random, device)
        self.pools = ThreadpoolController()
        self.held_out = np.flatnonzero(data.use == HELD_OUT)[:: data.stride]

    def epoch(self, module: Module, optimizer: torch.optim.Optimizer) -> tuple[float, float]:
        """Train on shuffled rows, then evaluate the held-out ones."""
        data = self.data
        rows = np.flatnonzero(data.use == TRAINING)[self._phase() :: data.stride]
        parameters = [module.get_parameter(name) for name in _WEIGHTS]
        states = [_state(optimizer, parameter) for parameter in parameters]
        weights = tuple(_flat(parameter) for parameter in parameters)
        moments = tuple(tuple(_flat(state[name]) for state in states) for name in _MOMENTS)
        fixed = data.inputs, data.targets, module.columns_of_parts(), weights
        group = optimizer.param_groups[0]
        constants = AdamW(
            learning_rate=float(group["lr"]),
            weight_decay=float(group["weight_decay"]),
            beta1=float(group["betas"][0]),
            beta2=float(group["betas"][1]),
            epsilon=float(group["eps"]),
            largest_gradient=LARGEST_GRADIENT,
        )

        def train(batches: IntArray) -> float:
            loss = descend(*fixed, batches, moments, int(states[0]["step"]), constants)
            for state in states:
                state["step"] += len(batches)
            return loss

        with self.pools.limit(limits=1, user_api="blas"):  # such products are not worth sharing out
            training = self._mean(self.random.permutation(rows), train)
            return training, self._mean(self.held_out, lambda rows: mean_square(*fixed, rows))

    def _mean(self, rows: IntArray, loss: Callable[[IntArray], float]) -> float:
        """Return the mean of the loss over all rows in whole batches, and the rest in one."""
        rows = np.ascontiguousarray(rows)  # others would be compiled for, too
        whole = len(rows) // self.batch * self.batch
        pieces = rows[:whole].reshape(-1, self.batch), rows[whole:].reshape(1, -1)
        total = sum(loss(piece) * piece.size for piece in pieces if piece.size)
        return total / max(len(rows), 1)


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
