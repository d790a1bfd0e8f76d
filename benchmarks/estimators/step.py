"""One streaming step, features + rigid body + network or joint physics, beside bar and peers.

    python benchmarks/estimators/step.py

One core, without torch. Weights are random for the timing, which does not depend on them. The peers
run the same LSTM 35 -> 35 with its linear layer in the same run: torch eager, and onnxruntime where
it is installed (`pip install limo[bench]`). Wall time has in it whatever else the machine does;
processor time leaves that out. Then: how far a stream is from the zero-phase prediction, by delay.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from estimators.hybrid import HybridModel
from estimators.hybrid.features import FEATURE_SETS, feature_set
from estimators.hybrid.fitted_network import FittedNetwork, InputScaling, Scaling, normalise_inputs
from estimators.joint_physics import JointPhysics
from estimators.neural import LstmFcl, Mlp
from estimators.stream import Stream
from limo_driver.physics import CoulombFriction, Simulation, ViscousFriction
from limo_driver.recordings.filters.differentiation import differentiate
from limo_driver.recordings.recording import Recording
from limo_driver.types import JointSample, Motion

if TYPE_CHECKING:
    from collections.abc import Callable

RATE = 1000.0  # [Hz]
BARS = (25.0, 60.0)  # [µs], p50 and p99
WARM_UP = 50  # calls that compile and fill the caches
ROUNDS = 10  # in turn, so that all suffer alike from whatever else the machine does
EXAMPLE = Path(__file__).parents[2] / "examples" / "iiwa14_hysteretic.yaml"
IDENTIFIED = Simulation(
    "iiwa14",
    tuple(
        effect
        for j, (dry, slope) in enumerate(
            ((2.2, 4.0), (2.4, 4.2), (1.6, 2.4), (1.7, 2.6), (0.9, 1.1), (0.45, 0.55), (0.35, 0.4))
        )
        for effect in (
            CoulombFriction(joint=j + 1, tau_c=dry),
            ViscousFriction(joint=j + 1, f_v=slope),
        )
    ),
)


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


def motion(seconds: float, seed: int) -> Motion:
    """Return small reversing motion about a pose, with encoder steps of 1e-5 rad."""
    random = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE)) / RATE
    position = np.deg2rad([10, 40, -20, -70, 30, 50, -40]) + np.zeros((t.size, 7))
    for _ in range(3):
        w, phase = 2 * np.pi * random.uniform(0.1, 1.0, 7), random.uniform(0, 6.3, 7)
        position += random.uniform(0.01, 0.05, 7) * np.sin(t[:, None] * w + phase)
    position = 1e-5 * np.round(position / 1e-5)
    smooth = differentiate(t, position, 10.0, [slice(0, t.size)])
    return Motion(t, position, smooth.first, smooth.second)


def untrained(
    simulation: Simulation, features: str, kind: str, units: int | None = None
) -> HybridModel:
    """Return a hybrid of the usual size with random weights."""
    random, seen = np.random.default_rng(0), feature_set(features, 7)
    d, network = len(seen.inputs), {"mlp7": Mlp, "lstm-fcl": LstmFcl}[kind]
    columns = seen.columns if kind == "mlp7" or seen.own_joint else seen.columns[:1]
    hidden = 100 if kind == "mlp7" else 16 if seen.own_joint else columns.shape[1]
    hidden = units or hidden
    free = {"output_weight": np.zeros((len(columns), hidden, 7 // len(columns)))}
    shapes = network.shapes(*columns.shape, free)
    weights = {name: 0.1 * random.standard_normal(shape) for name, shape in shapes.items()}
    one = np.ones(d)
    model = HybridModel(simulation)
    model.fitted_ = FittedNetwork(
        seen,
        network(columns, weights),
        InputScaling(0 * one, one, -9 * one, 9 * one),
        Scaling(np.zeros(7), np.ones(7)),
        np.ones(7),
        RATE,
        bandwidth=10.0,
    )
    return model


class Timed:
    """Calls a step over and over, carrying its memory, and keeps the time of each call."""

    def __init__(self, name: str, step: Callable, state: object, inputs: list) -> None:
        self.name, self.step, self.state, self.inputs = name, step, state, inputs
        self.taken = 0
        self.wall: list[float] = []  # [µs]
        self.processor: list[float] = []  # [µs]
        self.turn(WARM_UP)
        self.wall.clear()
        self.processor.clear()

    def turn(self, calls: int) -> None:
        """Take as many steps; the clocks are read in between."""
        for _ in range(calls):
            given = self.inputs[self.taken % len(self.inputs)]
            self.taken += 1
            wall, processor = time.perf_counter(), time.thread_time()
            _, self.state = self.step(self.state, *given)
            processor, wall = time.thread_time() - processor, time.perf_counter() - wall
            self.wall.append(1e6 * wall)
            self.processor.append(1e6 * processor)

    def median(self) -> float:
        """Return the median wall time [µs]."""
        return float(np.median(self.wall))

    def show(self, note: str = "") -> None:
        """Print percentiles of both clocks."""
        clocks = (self.wall, self.processor)
        figures = "".join("".join(f"{v:9.1f}" for v in _percentiles(x)) + "  " for x in clocks)
        print(f"  {self.name:48}{figures}{note}")


def _percentiles(values: list[float]) -> list[float]:
    return np.percentile(values, (10, 50, 99)).tolist()


def measure(timed: list[Timed], calls: int) -> None:
    """Give all the same number of turns, one after the other."""
    for _ in range(ROUNDS):
        for one in timed:
            one.turn(calls // ROUNDS)


def fitted_physics() -> JointPhysics:
    """Return joint physics of the same arm, fitted to half a minute of its motion."""
    moved = motion(30.0, seed=3)
    noise = 0.02 * np.random.default_rng(0).standard_normal(moved.position.shape)
    torque = Simulation.load(EXAMPLE).predict(moved) + noise
    recording = Recording.from_arrays(moved.time, moved.position, torque)
    return JointPhysics(IDENTIFIED).fit([recording])


def own_parts(model: HybridModel, samples: list[JointSample]) -> list[Timed]:
    """Return the parts of a step of a model."""
    fitted, simulation = model.fitted, model.simulation
    rows = [sample.motion() for sample in samples]
    torques = [simulation.advance(simulation.init(), row)[0] for row in rows]
    seen = [(*given, simulation.body) for given in zip(rows, torques, strict=True)]
    features, table = fitted.features, fitted.inputs.table
    inputs = [(features.advance(features.init(), *given)[0],) for given in seen]
    for (x,) in inputs:
        normalise_inputs(x, table, fitted.columns)
    return [
        Timed(
            "  rigid body, 14 frictions",
            simulation.advance,
            simulation.init(),
            [(r,) for r in rows],
        ),
        Timed("  features", features.advance, features.init(), seen),
        Timed("  network", fitted.network.advance, fitted.network.init(1), inputs),
    ]


def peers(network: LstmFcl) -> list[Timed]:
    """Return the network in both peers, after checking that they compute the same."""
    x = np.random.default_rng(1).standard_normal((200, 1, 35))
    expected, _ = network.advance(network.init(1), x[:, 0])
    found: list[Timed] = []
    for name, build in (("torch eager", torch_step), ("onnxruntime", onnx_step)):
        try:
            step, state = build(network.weights)
        except ImportError as error:
            print(f"  {name}: not installed ({error}); pip install limo[bench]")
            continue
        inputs = [(row.astype(np.float32),) for row in x]
        after, outputs = state, []
        for given in inputs:
            y, after = step(after, *given)
            outputs.append(y[0])
        np.testing.assert_allclose(outputs, expected, atol=1e-4)
        found.append(Timed(f"network in {name}", step, state, inputs))
    return found


def late(epochs: int) -> None:
    """Print how far a stream is from the zero-phase prediction, by delay."""
    from estimators.hybrid.training.settings import TrainingSettings

    truth = Simulation.load(EXAMPLE)
    train, test = motion(40.0, seed=1), motion(12.0, seed=2)
    settings = TrainingSettings(
        model="lstm-fcl", rate=200.0, epochs=epochs, folds=1, batch=8, learning_rate=3e-3
    )
    recorded = Recording.from_arrays(train.time, train.position, truth.predict(train))
    model = HybridModel(IDENTIFIED, settings).fit([recorded])
    recording = Recording.from_arrays(test.time, test.position, truth.predict(test))
    found, exact = model.estimate(recording), recording.motion(10.0)
    zero = found.torque
    torque = recording.filtered_torque(10.0)
    print(f"\nstream against zero phase, RMS; LSTM-FCL of {epochs} epochs, 1 kHz, bandwidth 10 Hz")
    for name, predicted in (("rigid body", found.simulation), ("hybrid", zero)):
        error = np.sqrt(np.mean((predicted - torque)[1000:-1000] ** 2))
        print(f"  zero-phase {name:10} against the filtered torque {error:7.4f} N m")
    print("  delay   velocity  acceleration  torque, mean  worst joint")
    print("  [ms]    [rad/s]   [rad/s^2]     [N m]         [N m]")
    for delay in (0.02, 0.05, 0.1, 0.2):
        stream = Stream(model, RATE, delay)
        D = round(stream.delay * RATE)
        inner, before = slice(2 * D + 1000, -1000), slice(D + 1000, -1000 - D)
        moved, _ = stream.differentiator.advance(
            stream.init().signals, recording.time, recording.position
        )
        rows = [
            np.sqrt(np.mean((a[inner] - b[before]) ** 2, axis=0))
            for a, b in (
                (moved.velocity, exact.velocity),
                (moved.acceleration, exact.acceleration),
                (stream.predict(recording), zero),
            )
        ]
        print(
            f"  {1e3 * delay:4.0f}   {rows[0].mean():9.2e} {rows[1].mean():9.2e}     "
            f"{rows[2].mean():8.4f}      {rows[2].max():8.4f}"
        )


def main() -> None:
    """Print every figure beside its bar."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--calls", type=int, default=5000, help="of each step")
    options.add_argument("--epochs", type=int, default=40, help="of the model that is streamed")
    given = options.parse_args()
    moved = motion(4.0, seed=0)
    samples = [moved.sample(row) for row in range(len(moved))]
    steps = [(sample,) for sample in samples]
    main_model = untrained(IDENTIFIED, "all-joints", "lstm-fcl")

    def hybrid(name: str, model: HybridModel) -> Timed:
        return Timed(name, model.step, model.init(RATE), steps)

    first = [hybrid("step: Coulomb, viscous; all-joints lstm-fcl", main_model)]
    parts = own_parts(main_model, samples[:500])
    others = [
        hybrid(f"step: {name}; {features} {kind}", untrained(simulation, features, kind))
        for name, simulation in (
            ("Coulomb, viscous", IDENTIFIED),
            ("35 effects", Simulation.load(EXAMPLE)),
        )
        for features in FEATURE_SETS
        for kind in ("mlp7", "lstm-fcl")
    ]
    positions = list(
        zip(np.arange(10**6) / RATE, np.resize(moved.position, (10**6, 7)), strict=True)
    )
    streamed = [
        Timed(f"stream, delay 100 ms: {name}", stream.step, stream.init(), positions)
        for name, stream in (
            ("simulation alone", Stream(IDENTIFIED, RATE, 0.1)),
            ("lstm-fcl, with std", Stream(main_model, RATE, 0.1)),
            ("joint physics, with std", Stream(fitted_physics(), RATE, 0.1)),
        )
    ]
    assert "torch" not in sys.modules
    measure([*first, *parts, *streamed, *others], given.calls)
    network = main_model.fitted.network
    rivals = peers(network)
    again = own_parts(main_model, samples[:500])[-1]
    whole = hybrid("whole step, limo", main_model)
    measure([again, whole, *rivals], given.calls)
    columns = "".join(f"{name:>9}" for name in ("p10", "p50", "p99"))
    print(f"{'[µs], one core; wall, then processor':50}{columns}  {columns}")
    first[0].show(f"bar {BARS[0]:g} / {BARS[1]:g} (p50 / p99)")
    for one in (*parts, *streamed, *others):
        one.show()
    print("\nthe same network in peers, turn by turn in one run")
    for one in (again, whole, *rivals):
        ratios = one.median() / again.median(), one.median() / whole.median()
        one.show(f"{ratios[0]:5.1f} x network  {ratios[1]:5.2f} x step")
    late(given.epochs)


if __name__ == "__main__":
    main()
