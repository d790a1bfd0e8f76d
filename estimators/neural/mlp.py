"""MLPs: run sample by sample, and trained, both compiled.

Train an MLP-n on batches of rows, compiled: backpropagation, clipping of gradients and AdamW.

In batches of 50 rows a step of PyTorch is nearly all overhead. Here it is five small matrix
products for each part, without Python and without memory allocated in between.

Weights, gradients and moments are tuples of flat arrays in the order of `Mlp.shapes`: hidden weight
(G, f, H) and bias (G, H), output weight (G, H, m) and bias (G, m).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from estimators.neural.network import Network, free_size
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray

_MEMORYLESS: FloatArray = np.zeros(0)
LAYERS: Final = 4  # weights and biases of the two layers, the last of `shapes`
_ROWS = 8192  # evaluated at once, so that the hidden layer stays in the cache
Single: TypeAlias = "NDArray[np.float32]"
Flat: TypeAlias = "tuple[Single, ...]"

_ZERO: Final = np.float32(0.0)
_ONE: Final = np.float32(1.0)
_TINY: Final = np.float32(1e-30)  # moments below it move no weight: `epsilon` outweighs them


class Mlp(Network):
    """Per part, y = W₂ᵀ max(0, W₁ᵀ x + b₁) + b₂.

    Source: Çallar and Böttger, RA-L 2022, sec. III-B.2 (MLP-7: 35-100-1 for each joint).
    """

    kind: ClassVar[str] = "mlp7"
    recurrent: ClassVar[bool] = False

    @classmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
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
        """Evaluate T samples, each by itself."""
        return self._perceptrons(x, self.columns), memory

    def _perceptrons(self, x: FloatArray, columns: IntArray) -> FloatArray:
        """Evaluate T samples; a single one without the overhead of arrays."""
        w = self._arrays[-LAYERS:]
        if x.shape[0] == 1:
            return _row(np.ascontiguousarray(x), columns, *w)
        y = np.empty((x.shape[0], self.outputs))
        for start in range(0, x.shape[0], _ROWS):
            rows = x[start : start + _ROWS]
            y[start : start + _ROWS] = np.concatenate(
                [
                    np.maximum(rows[:, seen] @ V + b, 0.0) @ W + c
                    for seen, V, b, W, c in zip(columns, *w, strict=True)
                ],
                axis=1,
            )
        return y


@compiled(nogil=True)
def _row(
    x: FloatArray,
    columns: IntArray,
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


class AdamW(NamedTuple):
    """The constants of AdamW, and of the clipping before it.

    Source: Loshchilov and Hutter, "Decoupled Weight Decay Regularization", 2019, algorithm 2.
    """

    learning_rate: float
    weight_decay: float
    beta1: float
    beta2: float
    epsilon: float
    largest_gradient: float  # norm over all weights; a longer gradient is shortened to it


@compiled()
def descend(
    inputs: Single,
    targets: Single,
    columns: IntArray,
    weights: Flat,
    batches: IntArray,
    moments: tuple[Flat, ...],
    steps: int,
    constants: AdamW,
) -> float:
    """Take one step for each batch of rows; weights and moments change in place.

    Args:
        inputs: Normalised, (T, d).
        targets: Normalised torque, (T, G m).
        columns: Inputs that each part sees, (G, f).
        weights: Of the network.
        batches: Rows of each batch in turn, (steps, B).
        moments: Running means of the gradients and of their squares.
        steps: That were taken before.
        constants: Of the descent.

    Returns:
        Mean of the squared errors over all batches, each before its step.
    """
    x, hidden, y = _scratch(batches, columns, weights, targets)
    slope, gradients = np.empty_like(hidden[0]), _like(weights)
    total = 0.0
    for i in range(batches.shape[0]):
        _forward(inputs, batches[i], columns, weights, x, hidden, y)
        total += _errors(targets, batches[i], y)
        _backward(weights, x, hidden, y, slope, gradients)
        _step(weights, gradients, moments, steps + i + 1, constants)
    return total / (batches.size * targets.shape[1])


@compiled()
def mean_square(
    inputs: Single, targets: Single, columns: IntArray, weights: Flat, batches: IntArray
) -> float:
    """Return the mean of the squared errors over all batches; arguments as of `descend`."""
    x, hidden, y = _scratch(batches, columns, weights, targets)
    total = 0.0
    for i in range(batches.shape[0]):
        _forward(inputs, batches[i], columns, weights, x, hidden, y)
        total += _errors(targets, batches[i], y)
    return total / (batches.size * targets.shape[1])


@compiled()
def _scratch(
    batches: IntArray, columns: IntArray, weights: Flat, targets: Single
) -> tuple[Single, Single, Single]:
    """Make room for the inputs (G, B, f) of a batch, its hidden layer (G, B, H), outputs (G, B, m).

    Where all parts see the same inputs, these are there once, (1, B, f).
    """
    B, (G, f), shared = batches.shape[1], columns.shape, True
    for g in range(G):
        for i in range(f):
            shared &= columns[g, i] == columns[0, i]
    return (
        np.empty((1 if shared else G, B, f), np.float32),
        np.empty((G, B, weights[1].size // G), np.float32),
        np.empty((G, B, targets.shape[1] // G), np.float32),
    )


@compiled()
def _like(arrays: Flat) -> Flat:
    a, b, c, d = arrays
    return np.empty_like(a), np.empty_like(b), np.empty_like(c), np.empty_like(d)


@compiled()
def _shaped(arrays: Flat, x: Single, hidden: Single, y: Single) -> tuple[Single, ...]:
    """Return the arrays with the shapes that they have as weights."""
    (G, _, H), f, m = hidden.shape, x.shape[2], y.shape[2]
    a, b, c, d = arrays
    return a.reshape(G, f, H), b.reshape(G, H), c.reshape(G, H, m), d.reshape(G, m)


@compiled()
def _forward(
    inputs: Single,
    rows: IntArray,
    columns: IntArray,
    weights: Flat,
    x: Single,
    hidden: Single,
    y: Single,
) -> None:
    """Gather the inputs of the rows; compute the hidden layer and the outputs."""
    for k in range(x.shape[0]):
        for b in range(rows.size):
            for i in range(x.shape[2]):
                x[k, b, i] = inputs[rows[b], columns[k, i]]
    hidden_weight, hidden_bias, output_weight, output_bias = _shaped(weights, x, hidden, y)
    for g in range(hidden.shape[0]):
        np.dot(x[g % x.shape[0]], hidden_weight[g], hidden[g])
        for b in range(rows.size):
            for u in range(hidden.shape[2]):
                value = hidden[g, b, u] + hidden_bias[g, u]
                hidden[g, b, u] = _ZERO if value < _ZERO else value
        np.dot(hidden[g], output_weight[g], y[g])
        for b in range(rows.size):
            for i in range(y.shape[2]):
                y[g, b, i] += output_bias[g, i]


@compiled()
def _errors(targets: Single, rows: IntArray, y: Single) -> float:
    """Turn outputs into their errors; return the sum of the squares."""
    G, B, m = y.shape
    total = 0.0
    for g in range(G):
        for b in range(B):
            for i in range(m):
                error = y[g, b, i] - targets[rows[b], g * m + i]
                y[g, b, i] = error
                total += float(error * error)
    return total


@compiled()
def _backward(
    weights: Flat, x: Single, hidden: Single, errors: Single, slope: Single, gradients: Flat
) -> None:
    """Compute the gradients of the mean squared error; `errors` and `slope` are overwritten."""
    G, B, H = hidden.shape
    _, _, output_weight, _ = _shaped(weights, x, hidden, errors)
    to_hidden, to_hidden_bias, to_output, to_output_bias = _shaped(gradients, x, hidden, errors)
    to_hidden_bias[:] = _ZERO
    to_output_bias[:] = _ZERO
    for g in range(G):
        for b in range(B):
            for i in range(errors.shape[2]):
                errors[g, b, i] *= np.float32(2.0 / errors.size)
                to_output_bias[g, i] += errors[g, b, i]
        np.dot(hidden[g].T, errors[g], to_output[g])
        np.dot(errors[g], output_weight[g].T, slope)
        for b in range(B):
            for u in range(H):
                slope[b, u] = _ZERO if hidden[g, b, u] <= _ZERO else slope[b, u]
                to_hidden_bias[g, u] += slope[b, u]
        np.dot(x[g % x.shape[0]].T, slope, to_hidden[g])


@compiled(error_model="numpy", fastmath={"contract"})  # as vectors
def _step(
    weights: Flat, gradients: Flat, moments: tuple[Flat, ...], number: int, constants: AdamW
) -> None:
    """Clip the gradients and take step `number`, from 1."""
    scale = _clipping(gradients, constants.largest_gradient)
    beta1, beta2 = np.float32(constants.beta1), np.float32(constants.beta2)
    rest1, rest2 = np.float32(1.0 - constants.beta1), np.float32(1.0 - constants.beta2)
    epsilon = np.float32(constants.epsilon)
    kept = np.float32(1.0 - constants.learning_rate * constants.weight_decay)
    length = np.float32(constants.learning_rate / (1.0 - constants.beta1**number))
    spread = np.float32(1.0 / np.sqrt(1.0 - constants.beta2**number))
    # The moments of a unit that is never active fade into subnormal numbers, which are very slow.
    for k in range(len(weights)):
        w, gradient, mean, square = weights[k], gradients[k], moments[0][k], moments[1][k]
        for i in range(w.size):
            d = scale * gradient[i]
            first = beta1 * mean[i] + rest1 * d
            second = beta2 * square[i] + rest2 * d * d
            mean[i] = _ZERO if abs(first) < _TINY else first
            square[i] = _ZERO if second < _TINY else second
            w[i] = kept * w[i] - length * first / (spread * np.sqrt(second) + epsilon)


@compiled(error_model="numpy", fastmath={"reassoc"})  # sums in several lanes
def _clipping(gradients: Flat, largest: float) -> np.float32:
    """Return what the gradients are scaled by, at most 1, so that their norm is `largest`.

    The 1e-6 is that of `torch.nn.utils.clip_grad_norm_`.
    """
    total = _ZERO
    for k in range(len(gradients)):
        gradient = gradients[k]
        for i in range(gradient.size):
            total += gradient[i] * gradient[i]
    scale = np.float32(largest / (np.sqrt(total) + 1e-6))
    return _ONE if scale > _ONE else scale
