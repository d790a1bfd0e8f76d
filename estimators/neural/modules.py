"""The networks as PyTorch modules, for training only; `weights()` is what `Network` takes."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

Memory: TypeAlias = "list[tuple[Tensor, Tensor]] | None"


class Module(nn.Module):
    """G parts side by side; part g sees `columns[g]` of the inputs."""

    def __init__(self, columns: NDArray[np.int64], hidden: int, outputs: int) -> None:
        super().__init__()
        self.parts, self.inputs = columns.shape
        self.shared = bool((columns == columns[:1]).all())  # all parts see the same inputs
        self.register_buffer("columns", torch.from_numpy(columns.copy()))
        self.output_weight = _xavier(self.parts, hidden, outputs)
        self.output_bias = nn.Parameter(torch.zeros(self.parts, outputs))

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
        super().__init__(columns, hidden, outputs)
        self.hidden_weight = _xavier(self.parts, self.inputs, hidden)
        self.hidden_bias = nn.Parameter(torch.zeros(self.parts, hidden))

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, d) to (N, outputs)."""
        hidden = torch.baddbmm(self.hidden_bias[:, None], self._inputs(x), self.hidden_weight)
        y = torch.baddbmm(self.output_bias[:, None], torch.relu(hidden), self.output_weight)
        return y.transpose(0, 1).reshape(x.shape[0], -1)


class LstmModule(Module):
    """An LSTM and a linear layer for each part."""

    def __init__(self, columns: NDArray[np.int64], hidden: int, outputs: int) -> None:
        super().__init__(columns, hidden, outputs)
        self.input_weight = _xavier(self.parts, self.inputs, 4 * hidden)
        self.recurrent_weight = _xavier(self.parts, hidden, 4 * hidden)
        self.gate_bias = nn.Parameter(torch.zeros(self.parts, 4 * hidden))
        self.hidden = hidden

    def forward(self, x: Tensor, memory: Memory = None) -> tuple[Tensor, Memory]:
        """Map (B, T, d) and the memory before to (B, T, outputs) and the memory after."""
        outputs: list[Tensor] = []
        after: list[tuple[Tensor, Tensor]] = []
        for g in range(self.parts):
            zero = x.new_zeros(1, x.shape[0], self.hidden)
            h, c = memory[g] if memory is not None else (zero, zero)
            weights = [
                self.input_weight[g].T,
                self.recurrent_weight[g].T,
                self.gate_bias[g],
                torch.zeros_like(self.gate_bias[g]),
            ]
            seen = x[..., self.columns[g]]  # type: ignore[index]
            hidden, h, c = torch.lstm(
                seen, (h, c), weights, True, 1, 0.0, self.training, False, True
            )
            outputs.append(hidden @ self.output_weight[g] + self.output_bias[g])
            after.append((h.detach(), c.detach()))
        return torch.cat(outputs, dim=-1), after


def _xavier(parts: int, inputs: int, outputs: int) -> nn.Parameter:
    weight = torch.empty(parts, inputs, outputs)
    for part in weight:
        nn.init.xavier_uniform_(part)
    return nn.Parameter(weight)
