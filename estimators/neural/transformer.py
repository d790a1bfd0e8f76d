"""Transformer: encoder and decoder that look back within a block of samples."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np

from estimators.neural.network import Network, free_size
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray

NORM_EPSILON: Final = 1e-5
_LONGEST_PERIOD: Final = 10_000.0  # of the position encoding [rad^-1], as in the original
_ATTENTIONS: Final = 3  # with keys and values of their own: encoder, decoder, decoder to encoder
_KERNEL_WEIGHTS: Final = (  # as `_scan` unpacks them; arrays of a tuple have one type
    ("input_weight", "feedback_weight", "output_weight"),
    ("input_bias", "feedback_bias", "output_bias"),
    ("encoder_qkv", "decoder_qkv", "cross_qkv"),
    ("encoder_join", "decoder_join", "cross_join"),
    ("encoder_norm", "decoder_norm"),
    ("encoder_widen", "decoder_widen"),
    ("encoder_widen_bias", "decoder_widen_bias"),
    ("encoder_narrow", "decoder_narrow"),
    ("encoder_narrow_bias", "decoder_narrow_bias"),
)


class Transformer(Network):
    """Per part, y_t = C Decoder(y_(t-1), ..., Encoder(x_t, x_(t-1), ...)) + c.

    The original's layers: multi-head scaled dot-product attention, add and norm, two linear layers
    with ReLU, add and norm; the decoder first attends to its own previous outputs, then to the
    encoder. Sinusoids of the position are added to both inputs. The output is computed one sample
    at a time from the outputs before it, the first of a block from zeros.

    Attention looks back only, to the start of its block of T samples, where the memory of keys and
    values starts anew. At rates above that of training, `stride` of them run interleaved.

    Smaller than the original (d_model 512, 8 heads, 6 + 6 layers, feed-forward 4 d_model, dropout
    0.1), for one core: usually d_model 32, 2 heads, 2 + 2 layers, feed-forward 2 d_model, and
    nothing dropped, since there are hundreds of times more samples than weights.

    Source: Vaswani et al., "Attention Is All You Need", 2017; Çallar and Böttger, RA-L 2022,
    sec. III-B.4.
    """

    kind: ClassVar[str] = "transformer"
    recurrent: ClassVar[bool] = True

    @classmethod
    def shapes(
        cls, parts: int, inputs: int, weights: Mapping[str, FloatArray]
    ) -> dict[str, tuple[int, ...]]:
        """Return the shape of each weight; `*_qkv` gives queries, keys and values of each head."""
        block, d = (free_size(weights, "position_encoding", axis) for axis in (0, 1))
        layers, heads = (free_size(weights, "encoder_qkv", axis) for axis in (1, 4))
        return {
            "position_encoding": (block, d),
            **weight_shapes(
                parts,
                inputs,
                free_size(weights, "output_weight", 2),
                d,
                layers,
                heads,
                free_size(weights, "encoder_widen", 3),
            ),
        }

    def init(self, stride: int) -> FloatArray:
        """Return (which of the interleaved memories is next, and each of them), all zero."""
        return np.zeros(1 + stride * self._size)

    @property
    def _size(self) -> int:
        """Size of one memory: position in the block, last output, keys and values."""
        (T, d), layers = self.weights["position_encoding"].shape, self._layers
        return 1 + self.outputs + len(self.columns) * layers * _ATTENTIONS * 2 * T * d

    @property
    def _layers(self) -> int:
        return self.weights["encoder_qkv"].shape[1]

    def advance(self, memory: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Scan T samples."""
        after, w, parts = memory.copy(), self.weights, len(self.columns)
        memories = after[1:].reshape(-1, self._size)
        positions, first = memories[:, 0].astype(np.int64), int(after[0])
        outputs: list[FloatArray] = []
        for g, columns in enumerate(self.columns):
            weights = tuple(tuple(w[name][g] for name in names) for names in _KERNEL_WEIGHTS)
            seen, encoding = np.ascontiguousarray(x[:, columns]), w["position_encoding"]
            at = positions.copy()  # each part starts where all of them are
            outputs.append(_scan(seen, encoding, weights, at, memories, g, parts, first))
        after[0] = (first + x.shape[0]) % memories.shape[0]
        return np.concatenate(outputs, axis=1), after


def weight_shapes(
    parts: int, inputs: int, outputs: int, d: int, layers: int, heads: int, wide: int
) -> dict[str, tuple[int, ...]]:
    """Return the shapes of what is learned, the part as first index, the layer as second."""
    L = (parts, layers)
    qkv = (*L, 3, d, heads, d // max(heads, 1))
    block = {"widen": (d, wide), "widen_bias": (wide,), "narrow": (wide, d), "narrow_bias": (d,)}
    return {
        "input_weight": (parts, inputs, d),
        "input_bias": (parts, d),
        "feedback_weight": (parts, outputs, d),
        "feedback_bias": (parts, d),
        "output_weight": (parts, d, outputs),
        "output_bias": (parts, outputs),
        "encoder_qkv": qkv,
        "decoder_qkv": qkv,
        "cross_qkv": qkv,
        "encoder_join": (*L, d, d),
        "decoder_join": (*L, d, d),
        "cross_join": (*L, d, d),
        "encoder_norm": (*L, 2, 2, d),  # after attention and feed-forward: scale and shift
        "decoder_norm": (*L, 3, 2, d),
        **{f"{c}coder_{name}": (*L, *shape) for c in ("en", "de") for name, shape in block.items()},
    }


def position_encoding(length: int, d: int) -> FloatArray:
    """Return sinusoids of the position, (length, d)."""
    even = np.arange(0, d, 2)
    angle = np.arange(length)[:, None] / _LONGEST_PERIOD ** (even / d)
    return np.stack([np.sin(angle), np.cos(angle)], axis=-1).reshape(length, -1)[:, :d]


@compiled(nogil=True)
def _scan(
    x: FloatArray,
    encoding: FloatArray,
    weights: tuple[tuple[FloatArray, ...], ...],
    positions: IntArray,
    memories: FloatArray,
    g: int,
    parts: int,
    first: int,
) -> FloatArray:
    """Advance the memories (stride, size) of part g in place; return its outputs (T, m)."""
    linear, biases, qkv, join, norm, widen, widen_bias, narrow, narrow_bias = weights
    (block, d), layers, m = encoding.shape, qkv[0].shape[0], biases[2].size
    size = layers * 3 * block * d
    start = memories.shape[1] - size * 2 * (parts - g)  # what is kept of the parts stands last
    y = np.empty((x.shape[0], m))
    for t in range(x.shape[0]):
        i = (first + t) % positions.size
        p = positions[i]
        last = memories[i, 1 + g * m : 1 + (g + 1) * m]
        keys = memories[i, start : start + size].reshape(layers, 3, d, block)
        values = memories[i, start + size : start + 2 * size].reshape(layers, 3, d, block)
        if p == 0:
            last[:] = 0.0
        h = x[t] @ linear[0] + biases[0] + encoding[p]
        for a in range(qkv[0].shape[0]):
            k, v = keys[a], values[a]
            h = _norm(h + _attend(h, h, qkv[0][a], join[0][a], k[0], v[0], p), norm[0][a, 0])
            f = np.maximum(h @ widen[0][a] + widen_bias[0][a], 0.0)
            h = _norm(h + f @ narrow[0][a] + narrow_bias[0][a], norm[0][a, 1])
        o = last @ linear[1] + biases[1] + encoding[p]
        for a in range(qkv[1].shape[0]):
            k, v = keys[a], values[a]
            o = _norm(o + _attend(o, o, qkv[1][a], join[1][a], k[1], v[1], p), norm[1][a, 0])
            o = _norm(o + _attend(o, h, qkv[2][a], join[2][a], k[2], v[2], p), norm[1][a, 1])
            f = np.maximum(o @ widen[1][a] + widen_bias[1][a], 0.0)
            o = _norm(o + f @ narrow[1][a] + narrow_bias[1][a], norm[1][a, 2])
        found = o @ linear[2] + biases[2]
        for u in range(m):
            y[t, u] = last[u] = found[u]
        positions[i] = memories[i, 0] = (p + 1) % block
    return y


@compiled(nogil=True)
def _attend(
    x: FloatArray,
    source: FloatArray,
    qkv: FloatArray,
    join: FloatArray,
    keys: FloatArray,
    values: FloatArray,
    p: int,
) -> FloatArray:
    """Store key and value of `source` at p; return what x (d,) finds at 0 to p, (d,).

    Keys and values are (d, T), so that each inner loop runs along memory.
    """
    d, heads, width = qkv.shape[1:]
    query = x @ qkv[0].reshape(d, d)
    key_now, value_now = source @ qkv[1].reshape(d, d), source @ qkv[2].reshape(d, d)
    for u in range(d):  # keys[:, p] = ... would compile the message of its error
        keys[u, p], values[u, p] = key_now[u], value_now[u]
    found, scores = np.empty(d), np.empty(p + 1)
    for head in range(heads):
        scores[:] = 0.0
        for u in range(head * width, (head + 1) * width):
            scale, key = query[u] / np.sqrt(width), keys[u]
            for s in range(p + 1):
                scores[s] += scale * key[s]
        highest, total = scores.max(), 0.0
        for s in range(p + 1):
            scores[s] = np.exp(scores[s] - highest)
            total += scores[s]
        for u in range(head * width, (head + 1) * width):
            found[u] = _dot(scores, values[u]) / total
    return found @ join


@compiled(nogil=True, fastmath={"reassoc"})  # lets the compiler sum in several lanes
def _dot(a: FloatArray, b: FloatArray) -> float:
    """Return the sum of products over the length of `a`."""
    total = 0.0
    for i in range(a.size):
        total += a[i] * b[i]
    return total


@compiled(nogil=True)
def _norm(x: FloatArray, scale_and_shift: FloatArray) -> FloatArray:
    """Normalise (d,) to mean 0 and variance 1, then scale and shift."""
    x = x - x.mean()  # the argument stays as it is
    return x / np.sqrt(np.mean(x * x) + NORM_EPSILON) * scale_and_shift[0] + scale_and_shift[1]
