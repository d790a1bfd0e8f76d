"""Networks with memory, scanned over time: LSTM-FCL, LSTM-2 and GRU, cells; LRU, a state space."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Final

import numpy as np

from estimators.neural.mlp import LAYERS, Mlp
from estimators.neural.network import Network, free_size
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray

_LSTM_GATES: Final = 4


def cell_name(name: str, layer: int) -> str:
    """Return the name of a weight of the cell of a layer, counted from 0."""
    return name if layer == 0 else f"{name}_{layer + 1}"


class Lstm(Network):
    """Per part, LSTM cells with forget gates, each of which sees the output of the one before.

    The cells are trained at their own rate, below that of most recordings. They then run `stride`
    times interleaved: sample t continues what sample t - stride left, so that every sample is
    answered at its own time and nothing is held or interpolated.

    Source: Gers, Schmidhuber and Cummins, "Learning to forget", Neural Computation 2000.
    """

    recurrent: ClassVar[bool] = True
    gates: ClassVar[int] = _LSTM_GATES  # of a unit: input, forget, cell, output
    states: ClassVar[int] = 2  # values that a unit remembers: h and c

    @property
    def layers(self) -> int:
        """Number of cells, one above the other."""
        return sum(name.startswith("recurrent_weight") for name in self.weights)

    @property
    def hidden(self) -> int:
        """Units of the first cell of each part."""
        return self.weights["recurrent_weight"].shape[1]

    def init(self, stride: int) -> FloatArray:
        """Return (which of the interleaved memories is next, their h and c), all zero."""
        return np.zeros(1 + stride * self.states * len(self.columns) * int(self.units.sum()))

    @cached_property
    def units(self) -> IntArray:
        """Units of each cell, (layers,)."""
        weights = [self.weights[cell_name("recurrent_weight", i)] for i in range(self.layers)]
        return np.array([weight.shape[1] for weight in weights])

    @cached_property
    def packed(self) -> FloatArray:
        """All weights of the cells in a row: compiled code takes one array sooner than many."""
        names = ("input_weight", "recurrent_weight", "gate_bias")
        cells = [[self.weights[cell_name(name, i)] for name in names] for i in range(self.layers)]
        return np.concatenate([weight.ravel() for cell in cells for weight in cell])

    @classmethod
    def _cell_shapes(
        cls, parts: int, inputs: int, units: int, layer: int
    ) -> dict[str, tuple[int, ...]]:
        return {
            cell_name("input_weight", layer): (parts, inputs, cls.gates * units),
            cell_name("recurrent_weight", layer): (parts, units, cls.gates * units),
            cell_name("gate_bias", layer): (parts, cls.gates * units),
        }

    def _hidden(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples; return the output of the last cells (T, G H) and the memory after."""
        after = memory.copy()
        sizes = self.columns, self.units, self.gates, self.states
        return _scan(np.ascontiguousarray(x), *sizes, self.packed, after), after


class LstmFcl(Lstm):
    """Per part, y = Vᵀ h + c with h the output of one LSTM cell or two.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B.3 (LSTM-FCL).
    """

    kind: ClassVar[str] = "lstm-fcl"

    @classmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; gates are in the order of `gates`."""
        hidden = free_size(weights, "output_weight", 1)
        outputs = free_size(weights, "output_weight", 2)
        second = cls._cell_shapes(parts, hidden, hidden, 1)
        return {
            **cls._cell_shapes(parts, inputs, hidden, 0),
            **(second if any(name in weights for name in second) else {}),
            "output_weight": (parts, hidden, outputs),
            "output_bias": (parts, outputs),
        }

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        h, after = self._hidden(memory, x)
        W, bias = self.weights["output_weight"], self.weights["output_bias"]
        of_parts = h.reshape(len(h), *W.shape[:2]).swapaxes(0, 1)  # (G, T, H)
        return (of_parts @ W + bias[:, None]).swapaxes(0, 1).reshape(len(h), -1), after


class Gru(LstmFcl):
    """Per part, y = Vᵀ h + c with h the output of one gated recurrent unit or two.

    As in PyTorch, the reset gate scales what the memory gives to a candidate, not the memory; that
    part has no bias of its own.

    Source: Cho et al., "Learning phrase representations using RNN encoder-decoder", EMNLP 2014.
    """

    kind: ClassVar[str] = "gru"
    gates: ClassVar[int] = 3  # reset, update, candidate
    states: ClassVar[int] = 1  # h


class Lstm2(Lstm):
    """Per part, y = h of the second of two cells, whose units are the outputs: |y| < 1.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B.3 (LSTM-2: 35-35-7).
    """

    kind: ClassVar[str] = "lstm-2"

    @classmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; gates are in the order of `gates`."""
        hidden = free_size(weights, "recurrent_weight", 1)
        outputs = free_size(weights, cell_name("recurrent_weight", 1), 1)
        return {
            **cls._cell_shapes(parts, inputs, hidden, 0),
            **cls._cell_shapes(parts, hidden, outputs, 1),
        }

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        parts, m, _ = self.weights[cell_name("recurrent_weight", 1)].shape
        return parts * m

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        return self._hidden(memory, x)


@compiled(nogil=True)
def _scan(
    x: FloatArray,
    columns: IntArray,
    units: IntArray,
    of_unit: int,
    states: int,
    packed: FloatArray,
    memory: FloatArray,
) -> FloatArray:
    """Advance `memory` (see `init`) in place over T samples; return the last cells' h, (T, G H)."""
    (G, K), H, widest = columns.shape, units[-1], max(columns.shape[1], units.max())
    size = states * G * units.sum()
    stride = (memory.size - 1) // size
    y = np.empty((x.shape[0], G * H))
    seen, gates = np.empty(widest), np.empty(4 * widest)
    for t in range(x.shape[0]):
        first = 1 + int(memory[0]) * size
        memory[0] = (memory[0] + 1) % stride
        for g in range(G):
            for k in range(K):
                seen[k] = x[t, columns[g, k]]
            inputs, start, weight = K, first, 0
            for U in units:
                own = start + states * g * U
                h, c = memory[own : own + U], memory[own + (states - 1) * U : own + states * U]
                all_gates = of_unit * U
                V = _part(packed, weight, g, inputs, all_gates)
                weight += G * inputs * all_gates
                W = _part(packed, weight, g, U, all_gates)
                weight += G * U * all_gates
                bias = _part(packed, weight, g, 1, all_gates)[0]
                weight += G * all_gates
                if of_unit == _LSTM_GATES:
                    _advance_lstm(seen[:inputs], V, W, bias, gates, h, c)
                else:
                    _advance_gru(seen[:inputs], V, W, bias, gates, h)
                for u in range(U):  # seen[:U] = h would compile the message of its error
                    seen[u] = h[u]
                inputs, start = U, start + states * G * U
            for u in range(H):
                y[t, g * H + u] = seen[u]
    return y


@compiled(inline="always")
def _part(packed: FloatArray, start: int, g: int, rows: int, columns: int) -> FloatArray:
    """Return the matrix of part g of a weight (G, rows, columns) that begins at `start`."""
    first = start + g * rows * columns
    return packed[first : first + rows * columns].reshape(rows, columns)


@compiled(nogil=True)
def _advance_lstm(
    x: FloatArray,
    input_weight: FloatArray,
    recurrent_weight: FloatArray,
    bias: FloatArray,
    gates: FloatArray,
    h: FloatArray,
    c: FloatArray,
) -> None:
    """Advance h and c (U,) of one cell in place; `gates` is working memory."""
    U = h.size
    for u in range(4 * U):
        gates[u] = bias[u]
    for k in range(x.size):
        for u in range(4 * U):
            gates[u] += x[k] * input_weight[k, u]
    for k in range(U):
        for u in range(4 * U):
            gates[u] += h[k] * recurrent_weight[k, u]
    for u in range(U):
        keep = c[u] / (1.0 + np.exp(-gates[U + u]))
        c[u] = keep + np.tanh(gates[2 * U + u]) / (1.0 + np.exp(-gates[u]))
        h[u] = np.tanh(c[u]) / (1.0 + np.exp(-gates[3 * U + u]))


@compiled(nogil=True)
def _advance_gru(
    x: FloatArray,
    input_weight: FloatArray,
    recurrent_weight: FloatArray,
    bias: FloatArray,
    gates: FloatArray,
    h: FloatArray,
) -> None:
    """Advance h (U,) of one cell in place; the fourth part of `gates` is the memory's candidate."""
    U = h.size
    for u in range(3 * U):
        gates[u] = bias[u]
    for u in range(3 * U, 4 * U):
        gates[u] = 0.0
    for k in range(x.size):
        for u in range(3 * U):
            gates[u] += x[k] * input_weight[k, u]
    for k in range(U):
        for u in range(2 * U):
            gates[u] += h[k] * recurrent_weight[k, u]
        for u in range(2 * U, 3 * U):
            gates[U + u] += h[k] * recurrent_weight[k, u]
    for u in range(U):
        reset, kept = 1.0 / (1.0 + np.exp(-gates[u])), 1.0 / (1.0 + np.exp(-gates[U + u]))
        candidate = np.tanh(gates[2 * U + u] + reset * gates[3 * U + u])
        h[u] = candidate + kept * (h[u] - candidate)


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
    def _columns_read(self) -> IntArray:
        """What each perceptron reads of the inputs and states of all."""
        return np.arange(self.weights["hidden_weight"][..., 0].size).reshape(len(self.columns), -1)

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        after = memory.copy()
        transition, weight = self._arrays[:-LAYERS]
        seen = _scan_lru(np.ascontiguousarray(x), self.columns, transition, weight, after)
        return self._perceptrons(seen, self._columns_read), after


@compiled(nogil=True)
def _scan_lru(
    x: FloatArray,
    columns: IntArray,
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
