"""LRU: a diagonal linear state space scanned over time, and a perceptron that reads it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from estimators.neural.mlp import LAYERS, Mlp
from estimators.neural.network import free_size
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray


class Lru(Mlp):
    """Per part, complex states z that forget each at its own pace, and a perceptron on top.

        z_t = λ z_(t-1) + B x_t,  y_t = W₂ᵀ max(0, W₁ᵀ (x_t, Re z_t, Im z_t) + b₁) + b₂.

    λ is diagonal and within the unit circle. One layer of the original; the perceptron stands in
    place of its output matrix and gated unit. Above the rate of training, memories run interleaved,
    as those of an LSTM do.

    Source: Orvieto et al., "Resurrecting recurrent neural networks for long sequences", ICML 2023.
    """

    kind: ClassVar[str] = "lru"
    recurrent: ClassVar[bool] = True

    @classmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; real parts of all states stand before imaginary ones."""
        both = 2 * free_size(weights, "transition", 2)
        return {
            "transition": (parts, 2, both // 2),
            "input_weight": (parts, inputs, both),
            **super().shapes(parts, inputs + both, weights),
        }

    def init(self, stride: int) -> FloatArray:
        """Return (which of the interleaved memories is next, their z), all zero."""
        return np.zeros(1 + stride * self.weights["transition"].size)

    @cached_property
    def _columns_read(self) -> NDArray[np.int64]:
        """What each perceptron reads of the inputs and states of all."""
        return np.arange(self.weights["hidden_weight"][..., 0].size).reshape(len(self.columns), -1)

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        after = memory.copy()
        transition, weight = self._arrays[:-LAYERS]
        seen = _scan(np.ascontiguousarray(x), self.columns, transition, weight, after)
        return self._perceptrons(seen, self._columns_read), after


@compiled(nogil=True)
def _scan(
    x: FloatArray,
    columns: NDArray[np.int64],
    transition: FloatArray,
    input_weight: FloatArray,
    memory: FloatArray,
) -> FloatArray:
    """Advance `memory` (see `init`) in place; return inputs and states, (T, G (f + 2 S))."""
    (G, f), S, size = columns.shape, transition.shape[2], transition.size
    stride = (memory.size - 1) // size
    seen = np.empty((x.shape[0], G * (f + 2 * S)))
    for t in range(x.shape[0]):
        first = 1 + int(memory[0]) * size
        memory[0] = (memory[0] + 1) % stride
        for g in range(G):
            z = memory[first + 2 * g * S : first + 2 * (g + 1) * S]
            own = seen[t, g * (f + 2 * S) : (g + 1) * (f + 2 * S)]
            for s in range(S):
                real, imaginary = transition[g, 0, s], transition[g, 1, s]
                own[f + s] = real * z[s] - imaginary * z[S + s]
                own[f + S + s] = real * z[S + s] + imaginary * z[s]
            for k in range(f):
                own[k] = x[t, columns[g, k]]
                for s in range(2 * S):
                    own[f + s] += own[k] * input_weight[g, k, s]
            for s in range(2 * S):
                z[s] = own[f + s]
    return seen
