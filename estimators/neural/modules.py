"""The networks as torch trains them."""

from __future__ import annotations

from typing import ClassVar, Final, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from estimators.neural.lstm import Gru, Lstm, cell_name
from estimators.neural.transformer import NORM_EPSILON, position_encoding, weight_shapes
from limo_driver.types import FloatArray, IntArray

Memory: TypeAlias = "list[tuple[Tensor, ...]] | None"  # h and c of each cell; h, or states
_FADES: Final = 2.0, 200.0  # samples after which states of an LRU have faded to a third, at first
_TURNS: Final = np.pi / 10  # [rad] by sample that they turn, at most, at first
_WIDER: Final = 2  # feed-forward over d_model


class Module(nn.Module):
    """G parts side by side; part g sees `columns[g]` of the inputs."""

    def __init__(self, columns: IntArray) -> None:
        super().__init__()
        self.parts, self.inputs = columns.shape
        self.shared = bool((columns == columns[:1]).all())  # all parts see the same inputs
        self.register_buffer("columns", torch.from_numpy(columns.copy()))
        self._sees_all = bool((columns == np.arange(self.inputs)).all())  # in their order

    def columns_of_parts(self) -> IntArray:
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


class PerceptronModule(Module):
    """One hidden layer with ReLU for each part, which reads its inputs and `more` values."""

    def __init__(self, columns: IntArray, hidden: int, outputs: int, more: int = 0) -> None:
        super().__init__(columns)
        self.output_weight = _xavier(self.parts, hidden, outputs)
        self.output_bias = nn.Parameter(torch.zeros(self.parts, outputs))
        self.hidden_weight = _xavier(self.parts, self.inputs + more, hidden)
        self.hidden_bias = nn.Parameter(torch.zeros(self.parts, hidden))

    def _perceptrons(self, x: Tensor) -> Tensor:
        """Map what each part sees, (G, N, f), to (N, outputs)."""
        hidden = torch.baddbmm(self.hidden_bias[:, None], x, self.hidden_weight)
        y = torch.baddbmm(self.output_bias[:, None], torch.relu(hidden), self.output_weight)
        return y.transpose(0, 1).reshape(x.shape[1], -1)


class MlpModule(PerceptronModule):
    """What `Mlp` computes."""

    def forward(self, x: Tensor) -> Tensor:
        """Map (N, d) to (N, outputs)."""
        return self._perceptrons(self._inputs(x))


class LruModule(PerceptronModule):
    """What `Lru` computes, for all samples at once: a convolution with the powers of λ."""

    def __init__(self, columns: IntArray, states: int, hidden: int, outputs: int) -> None:
        super().__init__(columns, hidden, outputs, 2 * states)
        low, high = np.log(_FADES)
        fades = torch.rand(self.parts, states) * (high - low) + low
        self.log_rate = nn.Parameter(-fades)
        self.turn = nn.Parameter(torch.rand(self.parts, states) * _TURNS)
        self.input_weight = _xavier(self.parts, self.inputs, 2 * states)

    def weights(self) -> dict[str, FloatArray]:
        """Return the weights by the names that `Network` expects."""
        known = super().weights()
        rate = np.exp(known.pop("log_rate"))
        turn, kept = known.pop("turn"), np.exp(-rate)
        known["input_weight"] *= np.tile(np.sqrt(-np.expm1(-2 * rate)), 2)[:, None]
        return {**known, "transition": np.stack([kept * np.cos(turn), kept * np.sin(turn)], axis=1)}

    def forward(self, x: Tensor, memory: Memory = None) -> tuple[Tensor, Memory]:
        """Map (B, T, d) and the memory before to (B, T, outputs) and the memory after."""
        B, T, d = x.shape
        seen = self._inputs(x.reshape(-1, d)).reshape(self.parts, B, T, -1)
        rate = torch.exp(self.log_rate)
        scale = torch.sqrt(-torch.expm1(-2 * rate))[:, None, None]  # keeps their size at any rate
        u = torch.complex(*(seen @ self.input_weight[:, None]).chunk(2, dim=-1)) * scale
        steps = torch.arange(T + 1, device=x.device)[:, None]
        powers = torch.exp(torch.complex(-rate, self.turn)[:, None] * steps)  # (G, T + 1, S)
        both = torch.fft.fft(u, 2 * T, dim=2) * torch.fft.fft(powers[:, None, :T], 2 * T, dim=2)
        z = torch.fft.ifft(both, dim=2)[:, :, :T]
        if memory is not None:
            z = z + powers[:, None, 1:] * memory[0][0]
        read = torch.cat([seen, z.real, z.imag], dim=-1).flatten(1, 2)
        return self._perceptrons(read).reshape(B, T, -1), [(z[:, :, -1:].detach(),)]


class LstmModule(Module):
    """Cells for each part, one above the other, of the given units."""

    kind: ClassVar[type[Lstm]] = Lstm

    def __init__(self, columns: IntArray, units: tuple[int, ...]) -> None:
        super().__init__(columns)
        self.units = units
        below = (self.inputs, *units)
        for i, count in enumerate(units):
            gates = self.kind.gates * count
            weights = _xavier(self.parts, below[i], gates), _xavier(self.parts, count, gates)
            self.register_parameter(cell_name("input_weight", i), weights[0])
            self.register_parameter(cell_name("recurrent_weight", i), weights[1])
            bias = nn.Parameter(torch.zeros(self.parts, gates))
            self.register_parameter(cell_name("gate_bias", i), bias)

    def forward(self, x: Tensor, memory: Memory = None) -> tuple[Tensor, Memory]:
        """Map (B, T, d) and the memory before to (B, T, outputs) and the memory after."""
        outputs: list[Tensor] = []
        after: list[tuple[Tensor, ...]] = []
        for g in range(self.parts):
            y = x if self._sees_all else x[..., self.columns[g]]  # type: ignore[index]
            for i, count in enumerate(self.units):
                zero = x.new_zeros(1, len(x), count)
                before = memory[len(after)] if memory is not None else (zero,) * self.kind.states
                y, cell = self._cell(y, before, g, i)
                after.append(cell)
            outputs.append(self._output(y, g))
        return torch.cat(outputs, dim=-1) if self.parts > 1 else outputs[0], after

    def _cell(
        self, x: Tensor, memory: tuple[Tensor, ...], g: int, i: int
    ) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Scan the cell of part g in layer i; the memory after it has no gradient."""
        names = ("input_weight", "recurrent_weight", "gate_bias")
        V, W, bias = (self.get_parameter(cell_name(name, i))[g] for name in names)
        weights = [V.T, W.T, bias, torch.zeros_like(bias)]
        if x.is_cuda:  # cuDNN takes no gradient of weights that do not lie in one piece, in order
            pieces = torch.cat([w.reshape(-1) for w in weights]).split([w.numel() for w in weights])
            weights = [piece.view(w.shape) for piece, w in zip(pieces, weights, strict=True)]
        how = weights, True, 1, 0.0, self.training, False, True
        gru = self.kind is Gru
        y, *after = torch.gru(x, memory[0], *how) if gru else torch.lstm(x, memory, *how)
        return y, tuple(values.detach() for values in after)

    def _output(self, h: Tensor, g: int) -> Tensor:  # noqa: ARG002  # a subclass needs the part
        """Map the output of the last cell of part g to what the part gives."""
        return h


class LstmFclModule(LstmModule):
    """LSTM cells and a linear layer for each part."""

    def __init__(self, columns: IntArray, hidden: int, outputs: int, layers: int = 1) -> None:
        super().__init__(columns, (hidden,) * layers)
        self.output_weight = _xavier(self.parts, hidden, outputs)
        self.output_bias = nn.Parameter(torch.zeros(self.parts, outputs))

    def _output(self, h: Tensor, g: int) -> Tensor:
        return torch.nn.functional.linear(h, self.output_weight[g].T, self.output_bias[g])


class GruModule(LstmFclModule):
    """GRU cells and a linear layer for each part."""

    kind = Gru


def _xavier(parts: int, inputs: int, outputs: int) -> nn.Parameter:
    weight = torch.empty(parts, inputs, outputs)
    for part in weight:
        nn.init.xavier_uniform_(part)
    return nn.Parameter(weight)


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
        self, columns: IntArray, outputs: int, block: int, d: int, layers: int, heads: int
    ) -> None:
        super().__init__(columns)
        encoding = torch.from_numpy(position_encoding(block, d)).float()
        self.register_buffer("position_encoding", encoding)
        shapes = weight_shapes(self.parts, self.inputs, outputs, d, layers, heads, _WIDER * d)
        for name, shape in shapes.items():
            # Xavier's weights, zero biases, and norms that scale by 1
            values = torch.zeros(shape)
            if name.endswith("norm"):
                values[..., 0, :] = 1.0
            elif not name.endswith("bias"):
                fan_in, fan_out = shape[-2:] if not name.endswith("qkv") else (shape[3], shape[3])
                values.uniform_(-1.0, 1.0).mul_(np.sqrt(6.0 / (fan_in + fan_out)))
            self.register_parameter(name, nn.Parameter(values))

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
