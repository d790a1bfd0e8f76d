"""The network of a step in torch eager and in onnxruntime: what `step.py` compares with."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable


def torch_step(weights: dict[str, np.ndarray]) -> tuple[Callable, object]:
    """Return a step of the LSTM and linear layer in torch eager, and its first state."""
    import torch

    torch.set_num_threads(1)
    lstm, linear = torch.nn.LSTM(35, 35), torch.nn.Linear(35, 7)
    with torch.no_grad():
        for parameter, value in (
            (lstm.weight_ih_l0, weights["input_weight"][0].T),
            (lstm.weight_hh_l0, weights["recurrent_weight"][0].T),
            (lstm.bias_ih_l0, weights["gate_bias"][0]),
            (lstm.bias_hh_l0, 0 * weights["gate_bias"][0]),
            (linear.weight, weights["output_weight"][0].T),
            (linear.bias, weights["output_bias"][0]),
        ):
            parameter.copy_(torch.from_numpy(np.ascontiguousarray(value)))

    def step(state: object, x: np.ndarray) -> tuple[np.ndarray, object]:
        with torch.inference_mode():
            hidden, state = lstm(torch.from_numpy(x), state)
            return linear(hidden).numpy(), state

    return step, (torch.zeros(1, 35), torch.zeros(1, 35))


def onnx_step(weights: dict[str, np.ndarray]) -> tuple[Callable, object]:
    """Return the same in onnxruntime; ImportError without it."""
    import onnxruntime
    from onnx import TensorProto, helper, numpy_helper

    def gates(value: np.ndarray) -> np.ndarray:
        """Bring columns in our order of gates to rows in ONNX's, which has output second."""
        i, f, c, o = np.split(value, 4, axis=-1)
        return np.concatenate([i, o, f, c], axis=-1).T[None].astype(np.float32)

    bias = gates(weights["gate_bias"][0])
    tensors = {
        "W": gates(weights["input_weight"][0]),
        "R": gates(weights["recurrent_weight"][0]),
        "B": np.concatenate([bias, 0 * bias], axis=1),
        "V": weights["output_weight"][0].astype(np.float32),
        "b": weights["output_bias"][0].astype(np.float32),
        "flat": np.array([1, 35]),
    }
    nodes = [
        helper.make_node(
            "LSTM", ["x", "W", "R", "B", "", "h", "c"], ["", "h1", "c1"], hidden_size=35
        ),
        helper.make_node("Reshape", ["h1", "flat"], ["row"]),
        helper.make_node("Gemm", ["row", "V", "b"], ["y"]),
    ]
    shapes = {"x": [1, 1, 35], "h": [1, 1, 35], "c": [1, 1, 35]}
    results = {"y": [1, 7], "h1": [1, 1, 35], "c1": [1, 1, 35]}
    info = [
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
            for name, shape in of.items()
        ]
        for of in (shapes, results)
    ]
    constants = [numpy_helper.from_array(value, name) for name, value in tensors.items()]
    graph = helper.make_graph(nodes, "lstm", *info, constants)
    content = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        content.SerializeToString(), options, providers=["CPUExecutionProvider"]
    )

    def step(state: tuple, x: np.ndarray) -> tuple[np.ndarray, object]:
        y, h, c = session.run(None, {"x": x[None], "h": state[0], "c": state[1]})
        return y, (h, c)

    zero = np.zeros((1, 1, 35), np.float32)
    return step, (zero, zero)
