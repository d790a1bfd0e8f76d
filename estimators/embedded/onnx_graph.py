"""Write the network of a model as an ONNX graph: features in, learned torque out.

The graph is made of a dozen kinds of nodes straight from the weights, so that neither the training
modules nor PyTorch's exporter are needed, and numbers are those of the fitted network in float32.
Memory goes in and out, as in `step`: a caller gives back what it got, zeros at first.
"""

# onnx has no complete stubs
# pyright: reportPrivateImportUsage=false
from __future__ import annotations

from functools import singledispatchmethod
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from estimators.hybrid import HybridModel
from estimators.hybrid.fitted_network import FittedNetwork
from estimators.neural import Network
from estimators.neural.lstm import Gru, Lru, Lstm, LstmFcl, cell_name
from estimators.neural.mlp import Mlp
from limo_driver.errors import ConfigError
from limo_driver.runtime.plugins import require_package
from limo_driver.types import FloatArray

_OPSET: Final = 17
# Ours are input, forget, cell, output, and of a GRU reset, update, candidate
_GATES: Final = {4: (0, 3, 1, 2), 3: (1, 0, 2)}  # as ONNX has them
_SAMPLES: Final = "samples"  # the dimension that is free


def write_onnx(model: object, path: Path) -> None:
    """Write the network of a fitted model.

    Input `features` (samples, d), in the order and units that the metadata name; output `torque`
    (samples, n) [N m], what the network adds to the simulation. A recurrent one also takes `h`, an
    LSTM `c`, of each cell, and gives them `_after`; its samples have the rate of its training.

    Args:
        model: A fitted hybrid model.
        path: The file.

    Raises:
        MissingPackageError: `onnx` is not installed.
        ConfigError: The model has no network, or one without a form in ONNX, or the file cannot
            be written.
    """
    require_package("onnx", "an export to ONNX")
    import onnx

    if not isinstance(model, HybridModel):
        name = getattr(model, "name", type(model).__name__)
        raise ConfigError(f"a model of kind {name} has no network that ONNX could hold")
    written = _Graph(model.fitted).model(onnx)
    onnx.checker.check_model(written)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(written.SerializeToString())
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", path=path) from None


class _Graph:
    """Nodes and constants as they are added."""

    def __init__(self, fitted: FittedNetwork) -> None:
        self._fitted = fitted
        self._constants: dict[str, NDArray[Any]] = {}
        self._nodes: list[tuple[str, list[str], list[str], dict[str, Any]]] = []
        self._memory: dict[str, int] = {}  # units of each, by the name of the input
        scaling, network = fitted.inputs, fitted.network
        x = self._add("Max", "features", self._constant("lowest", scaling.lowest))
        x = self._add("Min", x, self._constant("highest", scaling.highest))
        x = self._add("Sub", x, self._constant("mean", scaling.mean))
        x = self._add("Div", x, self._constant("std", scaling.std))
        parts = [
            self._part(network, g, self._seen(x, g, own)) for g, own in enumerate(network.columns)
        ]
        y = self._add("Concat", *parts, axis=1)
        y = self._add("Mul", y, self._constant("slope", fitted.slope))
        y = self._add("Add", y, self._constant("offset", fitted.offset))
        self._nodes.append(("Identity", [y], ["torque"], {}))

    def model(self, onnx: Any) -> Any:  # noqa: ANN401  # the module and its ModelProto
        """Return it as onnx has it."""
        helper, real = onnx.helper, onnx.TensorProto.FLOAT
        fitted, features = self._fitted, self._fitted.features

        def values(name: str, *shape: int | str) -> Any:  # noqa: ANN401
            return helper.make_tensor_value_info(name, real, shape)

        memory = [(name, size) for name, size in self._memory.items()]
        graph = helper.make_graph(
            [helper.make_node(kind, *ends, **given) for kind, *ends, given in self._nodes],
            "limo",
            [
                values("features", _SAMPLES, len(features.inputs)),
                *(values(name, 1, 1, size) for name, size in memory),
            ],
            [
                values("torque", _SAMPLES, features.n),
                *(values(f"{name}_after", 1, 1, size) for name, size in memory),
            ],
            [onnx.numpy_helper.from_array(value, name) for name, value in self._constants.items()],
        )
        imports = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(graph, opset_imports=imports, producer_name="limo")
        model.ir_version = 8  # that of the opset: older runtimes read it
        about = {"features": ", ".join(map(str, features.inputs)), "rate": f"{fitted.rate:.9g}"}
        helper.set_model_props(model, about)
        return model

    def _seen(self, x: str, g: int, columns: NDArray[np.int64]) -> str:
        return self._add("Gather", x, self._constant(f"columns_{g}", columns, np.int64), axis=1)

    @singledispatchmethod
    def _part(self, network: Network, g: int, x: str) -> str:  # noqa: ARG002
        raise ConfigError(
            f"a network of kind {network.kind} has no form in ONNX; expected mlp7, lstm-2, "
            "lstm-fcl or gru"
        )

    _part.register(Lru, _part.func)  # of whose memory ONNX has no node

    @_part.register
    def _(self, network: Mlp, g: int, x: str) -> str:
        hidden = self._add("Relu", self._linear(network, "hidden", g, x))
        return self._linear(network, "output", g, hidden)

    @_part.register
    def _(self, network: Lstm, g: int, x: str) -> str:
        axis = self._constant("one", np.array([1]), np.int64)
        y = self._add("Unsqueeze", x, axis)  # a batch of one
        for i in range(network.layers):
            y = self._cell(network, g, i, y)
        y = self._add("Squeeze", y, axis)
        return self._linear(network, "output", g, y) if isinstance(network, LstmFcl) else y

    def _cell(self, network: Lstm, g: int, i: int, x: str) -> str:
        units = int(network.units[i])

        def weight(name: str) -> FloatArray:
            own = network.weights[cell_name(name, i)][g]
            gates = own.reshape(*own.shape[:-1], -1, units)[..., _GATES[network.gates], :]
            return gates.reshape(own.shape)

        at = f"{g}_{i}"
        bias = np.concatenate([weight("gate_bias"), np.zeros(network.gates * units)])
        gru = isinstance(network, Gru)
        memory = [f"{name}_{at}" for name in "hc"[: network.states]]
        given = [
            x,
            self._constant(f"input_weight_{at}", weight("input_weight").T[None]),
            self._constant(f"recurrent_weight_{at}", weight("recurrent_weight").T[None]),
            self._constant(f"gate_bias_{at}", bias[None]),
            "",  # all sequences are of the same length
            *memory,
        ]
        self._memory |= dict.fromkeys(memory, units)
        y = self._new()
        after = [f"{name}_after" for name in memory]
        own = {"linear_before_reset": 1} if gru else {}
        given_back = [y, *after], {"hidden_size": units, **own}
        self._nodes.append(("GRU" if gru else "LSTM", given, *given_back))
        axis = self._constant("one", np.array([1]), np.int64)
        return self._add("Squeeze", y, axis)  # of its one direction

    def _linear(self, network: Network, name: str, g: int, x: str) -> str:
        weight, bias = network.weights[f"{name}_weight"][g], network.weights[f"{name}_bias"][g]
        y = self._add("MatMul", x, self._constant(f"{name}_weight_{g}", weight))
        return self._add("Add", y, self._constant(f"{name}_bias_{g}", bias))

    def _add(self, kind: str, *inputs: str, **given: object) -> str:
        """Add a node with one output, and return its name."""
        y = self._new()
        self._nodes.append((kind, list(inputs), [y], given))
        return y

    def _new(self) -> str:
        return f"x{len(self._nodes)}"

    def _constant(self, name: str, value: FloatArray | NDArray[Any], kind: Any = np.float32) -> str:  # noqa: ANN401
        self._constants[name] = np.ascontiguousarray(value, dtype=kind)
        return name
