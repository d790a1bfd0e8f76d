"""The networks as PyTorch modules, for training only; `weights()` is what `Network` takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from estimators.neural.lstm import cell_name

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

Memory: TypeAlias = "list[tuple[Tensor, Tensor]] | None"  # h and c of each cell


class Module(nn.Module):
    """G parts side by side; part g sees `columns[g]` of the inputs."""

    def __init__(self, columns: NDArray[np.int64]) -> None:
        super().__init__()
        self.parts, self.inputs = columns.shape
        self.shared = bool((columns == columns[:1]).all())  # all parts see the same inputs
        self.register_buffer("columns", torch.from_numpy(columns.copy()))
        self._sees_all = bool((columns == np.arange(self.inputs)).all())  # in their order

    def columns_of_parts(self) -> NDArray[np.int64]:
        """Return the inputs that each part sees, (G, f)."""
        return self.get_buffer("columns").cpu().numpy()

    def weights(self) -> dict[str, FloatArray]:
        """Return the weights by the names that `Network` expects."""
        return {
            name: value.detach().double().cpu().numpy().copy()
            for name, value in self.named_parameters()
        }

    def _inputs(self, x: Tensor) -> Tensor:
        """Bring (N, d) to (G, N, f)."""
        if self.shared:
            return x[:, self.columns[0]].expand(self.parts, -1, -1)  # type: ignore[index]
        return x[:, self.columns].transpose(0, 1)  # type: ignore[index]


class MlpModule(Module):
    """One hidden layer with ReLU for each part."""

    def __init__(self, columns: NDArray[np.int64], hidden: int, outputs: int) -> None:
        super().__init__(columns)
        self.output_weight = _xavier(self.parts, hidden, outputs)
        self.output_bias = nn.Parameter(torch.zeros(self.parts, outputs))
        self.hidden_weight = _xavier(self.parts, self.inputs, hidden)
        self.hidden_bias = nn.Parameter(torch.zeros(self.parts, hidden))

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, d) to (N, outputs)."""
        hidden = torch.baddbmm(self.hidden_bias[:, None], self._inputs(x), self.hidden_weight)
        y = torch.baddbmm(self.output_bias[:, None], torch.relu(hidden), self.output_weight)
        return y.transpose(0, 1).reshape(x.shape[0], -1)


class LstmModule(Module):
    """LSTM cells for each part, one above the other, of the given units."""

    def __init__(self, columns: NDArray[np.int64], units: tuple[int, ...]) -> None:
        super().__init__(columns)
        self.units = units
        below = (self.inputs, *units)
        for i, count in enumerate(units):
            weights = (
                _xavier(self.parts, below[i], 4 * count),
                _xavier(self.parts, count, 4 * count),
            )
            self.register_parameter(cell_name("input_weight", i), weights[0])
            self.register_parameter(cell_name("recurrent_weight", i), weights[1])
            bias = nn.Parameter(torch.zeros(self.parts, 4 * count))
            self.register_parameter(cell_name("gate_bias", i), bias)

    def forward(self, x: Tensor, memory: Memory = None) -> tuple[Tensor, Memory]:
        """Map (B, T, d) and the memory before to (B, T, outputs) and the memory after."""
        outputs: list[Tensor] = []
        after: list[tuple[Tensor, Tensor]] = []
        for g in range(self.parts):
            y = x if self._sees_all else x[..., self.columns[g]]  # type: ignore[index]
            for i, count in enumerate(self.units):
                zero = x.new_zeros(1, len(x), count)
                before = memory[len(after)] if memory is not None else (zero, zero)
                y, cell = self._cell(y, before, g, i)
                after.append(cell)
            outputs.append(self._output(y, g))
        return torch.cat(outputs, dim=-1) if self.parts > 1 else outputs[0], after

    def _cell(
        self, x: Tensor, memory: tuple[Tensor, Tensor], g: int, i: int
    ) -> tuple[Tensor, tuple[Tensor, Tensor]]:
        """Scan the cell of part g in layer i; the memory after it has no gradient."""
        names = ("input_weight", "recurrent_weight", "gate_bias")
        V, W, bias = (self.get_parameter(cell_name(name, i))[g] for name in names)
        weights = [V.T, W.T, bias, torch.zeros_like(bias)]
        if x.is_cuda:  # cuDNN takes no gradient of weights that do not lie in one piece, in order
            pieces = torch.cat([w.reshape(-1) for w in weights]).split([w.numel() for w in weights])
            weights = [piece.view(w.shape) for piece, w in zip(pieces, weights, strict=True)]
        y, h, c = torch.lstm(x, memory, weights, True, 1, 0.0, self.training, False, True)
        return y, (h.detach(), c.detach())

    def _output(self, h: Tensor, g: int) -> Tensor:  # noqa: ARG002  # a subclass needs the part
        """Map the output of the last cell of part g to what the part gives."""
        return h


class LstmFclModule(LstmModule):
    """LSTM cells and a linear layer for each part."""

    def __init__(
        self, columns: NDArray[np.int64], hidden: int, outputs: int, layers: int = 1
    ) -> None:
        super().__init__(columns, (hidden,) * layers)
        self.output_weight = _xavier(self.parts, hidden, outputs)
        self.output_bias = nn.Parameter(torch.zeros(self.parts, outputs))

    def _output(self, h: Tensor, g: int) -> Tensor:
        return torch.nn.functional.linear(h, self.output_weight[g].T, self.output_bias[g])


def _xavier(parts: int, inputs: int, outputs: int) -> nn.Parameter:
    weight = torch.empty(parts, inputs, outputs)
    for part in weight:
        nn.init.xavier_uniform_(part)
    return nn.Parameter(weight)
