"""LSTM-FCL: a recurrent cell and a linear layer, scanned over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numba import njit

from estimators.neural.network import Network, free_size

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray


class LstmFcl(Network):
    """Per part, y = Vᵀ h + c with h the output of an LSTM with forget gate.

    The cell is trained at its own rate, below that of most recordings. It then runs `stride` times
    interleaved: sample t continues what sample t - stride left, so that every sample is answered
    at its own time and nothing is held or interpolated.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B.3 (LSTM-FCL); Gers, Schmidhuber and Cummins,
    "Learning to forget", Neural Computation 2000.
    """

    kind: ClassVar[str] = "lstm-fcl"
    recurrent: ClassVar[bool] = True

    @staticmethod
    def shapes(
        parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; gates are in the order input, forget, cell, output."""
        hidden = free_size(weights, "output_weight", 1)
        outputs = free_size(weights, "output_weight", 2)
        return {
            "input_weight": (parts, inputs, 4 * hidden),
            "recurrent_weight": (parts, hidden, 4 * hidden),
            "gate_bias": (parts, 4 * hidden),
            "output_weight": (parts, hidden, outputs),
            "output_bias": (parts, outputs),
        }

    def init(self, stride: int) -> FloatArray:
        """Return (which of the interleaved memories is next, their h and c), all zero."""
        return np.zeros(1 + stride * 2 * len(self.columns) * self.hidden)

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        after = memory.copy()
        cells = after[1:].reshape(-1, 2, len(self.columns), self.hidden)
        w = self.weights
        y = _scan(
            np.ascontiguousarray(x),
            self.columns,
            w["input_weight"],
            w["recurrent_weight"],
            w["gate_bias"],
            w["output_weight"],
            w["output_bias"],
            cells,
            int(after[0]),
        )
        after[0] = (int(after[0]) + x.shape[0]) % cells.shape[0]
        return y, after


@njit(cache=True)
def _scan(
    x: FloatArray,
    columns: NDArray[np.int64],
    input_weight: FloatArray,
    recurrent_weight: FloatArray,
    gate_bias: FloatArray,
    output_weight: FloatArray,
    output_bias: FloatArray,
    cells: FloatArray,
    first: int,
) -> FloatArray:
    """Advance `cells` (stride, 2, G, H) in place; return the outputs (T, G m)."""
    G, H, m = output_weight.shape
    y = np.empty((x.shape[0], G * m))
    gates = np.empty(4 * H)
    for t in range(x.shape[0]):
        cell = cells[(first + t) % cells.shape[0]]
        for g in range(G):
            h, c = cell[0, g], cell[1, g]
            gates[:] = gate_bias[g]
            for k in range(columns.shape[1]):
                value = x[t, columns[g, k]]
                for u in range(4 * H):
                    gates[u] += value * input_weight[g, k, u]
            for k in range(H):
                for u in range(4 * H):
                    gates[u] += h[k] * recurrent_weight[g, k, u]
            for u in range(H):
                keep = c[u] / (1.0 + np.exp(-gates[H + u]))
                c[u] = keep + np.tanh(gates[2 * H + u]) / (1.0 + np.exp(-gates[u]))
                h[u] = np.tanh(c[u]) / (1.0 + np.exp(-gates[3 * H + u]))
            for i in range(m):
                total = output_bias[g, i]
                for u in range(H):
                    total += h[u] * output_weight[g, u, i]
                y[t, g * m + i] = total
    return y
