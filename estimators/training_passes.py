"""One pass over the training motion: by rows for a perceptron, by sequences for an LSTM."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, cast

import numpy as np
import torch

from estimators.training_data import HELD_OUT, TRAINING, TrainingData
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    from estimators.neural.modules import LstmModule, MlpModule

CARRIED: Final = 10  # sequences that a recurrent memory is carried through
_FEWEST_CHUNKS: Final = 4  # in the longest stretch, even of a short recording
_LARGEST_GRADIENT: Final = 1.0  # norm
_EVALUATED_ROWS: Final = 16384


@dataclass
class _Mean:
    """Mean of squared errors, gathered batch by batch."""

    total: float = 0.0
    count: int = 0

    def add(self, squares: Tensor) -> None:
        self.total += float(squares.detach().sum())
        self.count += squares.numel()

    @property
    def value(self) -> float:
        return self.total / self.count if self.count else 0.0


class Passes(ABC):
    """Goes over the training motion once in an epoch, in a new order each time.

    Args:
        data: Inputs, targets and who sees which rows.
        batch: Rows, or sequences, of one step of the optimiser.
        random: Draws the order.
    """

    def __init__(self, data: TrainingData, batch: int, random: np.random.Generator) -> None:
        self.data, self.batch, self.random = data, batch, random
        self.inputs = torch.from_numpy(data.inputs)
        self.targets = torch.from_numpy(data.targets)

    @abstractmethod
    def epoch(
        self, module: torch.nn.Module, optimizer: torch.optim.Optimizer
    ) -> tuple[float, float]:
        """Train for one pass; return training and held-out loss."""

    def _phase(self) -> int:
        """Draw which of every `stride` rows are used: each epoch sees others."""
        return int(self.random.integers(self.data.stride))


class RowPasses(Passes):
    """For networks without memory."""

    def __init__(self, data: TrainingData, batch: int, random: np.random.Generator) -> None:
        super().__init__(data, batch, random)
        self.held_out = torch.from_numpy(np.flatnonzero(data.use == HELD_OUT)[:: data.stride])

    def epoch(
        self, module: torch.nn.Module, optimizer: torch.optim.Optimizer
    ) -> tuple[float, float]:
        """Train on shuffled rows, then evaluate the held-out ones."""
        rows = np.flatnonzero(self.data.use == TRAINING)[self._phase() :: self.data.stride]
        order = torch.from_numpy(self.random.permutation(rows))
        training, held_out = _Mean(), _Mean()
        for batch in order.split(self.batch):
            squares = self._squares(cast("MlpModule", module), batch)
            _descend(squares.mean(), module, optimizer)
            training.add(squares)
        with torch.no_grad():
            for batch in self.held_out.split(_EVALUATED_ROWS) if self.held_out.numel() else ():
                held_out.add(self._squares(cast("MlpModule", module), batch))
        return training.value, held_out.value

    def _squares(self, module: MlpModule, rows: Tensor) -> Tensor:
        return (module(self.inputs[rows]) - self.targets[rows]) ** 2


class SequencePasses(Passes):
    """For networks with memory: chunks of several sequences, whose memory is carried along.

    The network scans the whole chunk, held-out motion included, as it will in use; the loss is
    taken at training rows only.

    Raises:
        RecordingError: No stretch is as long as a sequence.
    """

    def __init__(
        self, data: TrainingData, batch: int, random: np.random.Generator, length: int
    ) -> None:
        super().__init__(data, batch, random)
        self.use = torch.from_numpy(data.use)
        self.length = length
        longest = max((rows.stop - rows.start) // data.stride for rows in data.stretches)
        if longest < length:
            raise RecordingError(
                f"the longest stretch without a gap has {longest} samples at {data.rate:.4g} Hz "
                f"({longest / data.rate:.3g} s), but a sequence needs {length}; record longer "
                "motion or ask for shorter sequences"
            )
        carried = min(CARRIED, longest // (length * _FEWEST_CHUNKS))
        self.chunk = max(1, carried) * length

    def epoch(
        self, module: torch.nn.Module, optimizer: torch.optim.Optimizer
    ) -> tuple[float, float]:
        """Train on shuffled chunks; the held-out loss comes from the same scan."""
        starts = torch.from_numpy(self.random.permutation(self._starts()))
        training, held_out = _Mean(), _Mean()
        for batch in starts.split(self.batch):
            rows = batch[:, None] + self.data.stride * torch.arange(self.chunk)
            memory = None
            for part in rows.split(self.length, dim=1):
                y, memory = cast("LstmModule", module)(self.inputs[part], memory)
                squares, use = (y - self.targets[part]) ** 2, self.use[part]
                if (use == TRAINING).any():
                    _descend(squares[use == TRAINING].mean(), module, optimizer)
                training.add(squares[use == TRAINING])
                held_out.add(squares[use == HELD_OUT])
        return training.value, held_out.value

    def _starts(self) -> NDArray[np.int64]:
        """Cut each stretch into chunks from a random row on."""
        span = self.chunk * self.data.stride
        starts: list[NDArray[np.int64]] = []
        for rows in self.data.stretches:
            spare = rows.stop - rows.start - span
            if spare >= 0:
                first = rows.start + int(self.random.integers(min(spare, span - 1) + 1))
                starts.append(np.arange(first, rows.stop - span + 1, span))
        return np.concatenate(starts)


def _descend(loss: Tensor, module: torch.nn.Module, optimizer: torch.optim.Optimizer) -> None:
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(module.parameters(), _LARGEST_GRADIENT)
    optimizer.step()
