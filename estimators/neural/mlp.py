"""MLP-n: one small perceptron for each joint, side by side."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np

from estimators.neural.network import Network, free_size
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

_MEMORYLESS: FloatArray = np.zeros(0)
_ROWS = 8192  # evaluated at once, so that the hidden layer stays in the cache


class Mlp(Network):
    """Per part, y = W₂ᵀ max(0, W₁ᵀ x + b₁) + b₂.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B.2 (MLP-7: 35-100-1 for each joint).
    """

    kind: ClassVar[str] = "mlp7"
    recurrent: ClassVar[bool] = False

    @staticmethod
    def shapes(
        parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight."""
        hidden = free_size(weights, "output_weight", 1)
        outputs = free_size(weights, "output_weight", 2)
        return {
            "hidden_weight": (parts, inputs, hidden),
            "hidden_bias": (parts, hidden),
            "output_weight": (parts, hidden, outputs),
            "output_bias": (parts, outputs),
        }

    def init(self, stride: int) -> FloatArray:  # noqa: ARG002  # it has no memory
        """Return an empty memory."""
        return _MEMORYLESS

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Evaluate T samples, each by itself; a single one without the overhead of arrays."""
        if x.shape[0] == 1:
            return _row(np.ascontiguousarray(x), self.columns, *self._arrays), memory
        y = np.empty((x.shape[0], self.outputs))
        for start in range(0, x.shape[0], _ROWS):
            rows = slice(start, start + _ROWS)
            y[rows] = np.concatenate([self._part(g, x[rows]) for g in range(len(self.columns))], 1)
        return y, memory

    def _part(self, g: int, x: FloatArray) -> FloatArray:
        w = self.weights
        hidden = x[:, self.columns[g]] @ w["hidden_weight"][g] + w["hidden_bias"][g]
        return np.maximum(hidden, 0.0) @ w["output_weight"][g] + w["output_bias"][g]


@compiled(nogil=True)
def _row(
    x: FloatArray,
    columns: NDArray[np.int64],
    hidden_weight: FloatArray,
    hidden_bias: FloatArray,
    output_weight: FloatArray,
    output_bias: FloatArray,
) -> FloatArray:
    """Evaluate one sample (1, d); return the outputs, (1, G m)."""
    G, H, m = output_weight.shape
    y = np.empty((1, G * m))
    hidden = np.empty(H)
    for g in range(G):
        for u in range(H):  # hidden[:] = ... would compile the message of its error
            hidden[u] = hidden_bias[g, u]
        for k in range(columns.shape[1]):
            value = x[0, columns[g, k]]
            for u in range(H):
                hidden[u] += value * hidden_weight[g, k, u]
        for i in range(m):
            total = output_bias[g, i]
            for u in range(H):
                total += max(hidden[u], 0.0) * output_weight[g, u, i]
            y[0, g * m + i] = total
    return y
