"""The transformer as a PyTorch module, for training only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from estimators.neural.modules import Module
from estimators.neural.transformer import NORM_EPSILON, position_encoding, weight_shapes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

_WIDER: Final = 2  # feed-forward over d_model


class TransformerModule(Module):
    """What `Transformer` computes, for whole blocks at once.

    Args:
        columns: Inputs that each part sees, (G, f).
        outputs: Of each part.
        block: Samples T of a block.
        d: Width d_model.
        layers: Of the encoder, and of the decoder.
        heads: Of each attention; d is a multiple.
    """

    def __init__(
        self, columns: NDArray[np.int64], outputs: int, block: int, d: int, layers: int, heads: int
    ) -> None:
        super().__init__(columns)
        encoding = torch.from_numpy(position_encoding(block, d)).float()
        self.register_buffer("position_encoding", encoding)
        shapes = weight_shapes(self.parts, self.inputs, outputs, d, layers, heads, _WIDER * d)
        for name, shape in shapes.items():
            self.register_parameter(name, nn.Parameter(_initial(name, shape)))

    def weights(self) -> dict[str, FloatArray]:
        """Return the weights by the names that `Network` expects, the encoding among them."""
        encoding = self.get_buffer("position_encoding")
        return {**super().weights(), "position_encoding": encoding.double().cpu().numpy().copy()}

    def forward(self, x: Tensor, before: Tensor) -> Tensor:
        """Map blocks (B, T, inputs) and the outputs one sample before to outputs, (B, T, G m)."""
        m = before.shape[-1] // self.parts
        parts = [
            self._part(x[..., self.columns[g]], before[..., g * m : (g + 1) * m], g)  # type: ignore[index]
            for g in range(self.parts)
        ]
        return torch.cat(parts, dim=-1)

    def _part(self, x: Tensor, before: Tensor, g: int) -> Tensor:
        w = {name: value[g] for name, value in self.named_parameters()}
        encoding = self.get_buffer("position_encoding")[: x.shape[1]]
        h = x @ w["input_weight"] + w["input_bias"] + encoding
        for i in range(len(w["encoder_qkv"])):
            norms = w["encoder_norm"][i]
            h = _norm(h + _attend(h, h, w["encoder_qkv"][i], w["encoder_join"][i]), norms[0])
            h = _norm(h + _forward(h, w, "encoder", i), norms[1])
        o = before @ w["feedback_weight"] + w["feedback_bias"] + encoding
        for i in range(len(w["decoder_qkv"])):
            norms = w["decoder_norm"][i]
            o = _norm(o + _attend(o, o, w["decoder_qkv"][i], w["decoder_join"][i]), norms[0])
            o = _norm(o + _attend(o, h, w["cross_qkv"][i], w["cross_join"][i]), norms[1])
            o = _norm(o + _forward(o, w, "decoder", i), norms[2])
        return o @ w["output_weight"] + w["output_bias"]


def _attend(x: Tensor, source: Tensor, qkv: Tensor, join: Tensor) -> Tensor:
    """Let each sample of x (B, T, d) attend to those of `source` up to its own time."""
    _, d, heads, width = qkv.shape
    q, k, v = (
        (seen @ weight.reshape(d, d)).unflatten(-1, (heads, width)).transpose(1, 2)
        for seen, weight in zip((x, source, source), qkv, strict=True)
    )
    found = functional.scaled_dot_product_attention(q, k, v, is_causal=True)  # (B, heads, T, width)
    return found.transpose(1, 2).flatten(-2) @ join


def _forward(x: Tensor, w: dict[str, Tensor], coder: str, i: int) -> Tensor:
    wide = torch.relu(x @ w[f"{coder}_widen"][i] + w[f"{coder}_widen_bias"][i])
    return wide @ w[f"{coder}_narrow"][i] + w[f"{coder}_narrow_bias"][i]


def _norm(x: Tensor, scale_and_shift: Tensor) -> Tensor:
    return functional.layer_norm(x, x.shape[-1:], *scale_and_shift, eps=NORM_EPSILON)


def _initial(name: str, shape: tuple[int, ...]) -> Tensor:
    """Return Xavier's weights, zero biases, and norms that scale by 1."""
    values = torch.zeros(shape)
    if name.endswith("norm"):
        values[..., 0, :] = 1.0
    elif not name.endswith("bias"):
        fan_in, fan_out = shape[-2:] if not name.endswith("qkv") else (shape[3], shape[3])
        values.uniform_(-1.0, 1.0).mul_(np.sqrt(6.0 / (fan_in + fan_out)))
    return values
