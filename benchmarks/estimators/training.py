"""Minutes to train each network by the paper's protocol, beside a bar and a bare loop of PyTorch.

    python benchmarks/estimators/training.py
    python benchmarks/estimators/training.py --samples 804205 --epochs 3 --models lstm-fcl

Trains on a synthetic motion of the iiwa 14, sub-sequences of 500 samples, batches of 50, one thread
of the CPU. An epoch is timed from the end of the one before, so that neither the inputs, which are
computed once, nor compilation counts. Minutes are scaled to 100 epochs of the paper's 804 205
samples; an epoch is linear in both. The bare loop goes over one batch of random numbers with AdamW.
For mlp7 it has the same perceptrons and clips their gradients, for four fifths of the samples, as
many as training descends on. For the others it has an LSTM and a linear layer, for all samples;
training holds a fifth out, which it only evaluates.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np
import torch

from estimators.hybrid.model import train
from estimators.hybrid.training.settings import paper_settings
from estimators.neural.modules import MlpModule
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

SAMPLES, EPOCHS, RATE = 804_205, 100, 223.4  # the paper's
LENGTH, BATCH, INPUTS, JOINTS, HIDDEN = 500, 50, 35, 7, 100
TRAINED = 0.8  # of the samples
BARS = {"lstm-fcl": 6.0, "mlp7": 10.0, "transformer": 40.0}  # [min]


@dataclass(frozen=True)
class Clock:
    """A moment; CPU time counts only this process, which tells a busy machine from slow code."""

    wall: float
    cpu: float

    @classmethod
    def now(cls) -> Clock:
        """Read both clocks."""
        return cls(time.perf_counter(), time.process_time())

    def minutes(self, samples: int) -> tuple[float, float]:
        """Return wall and CPU time since then for all that the paper trains on [min]."""
        now, scale = Clock.now(), SAMPLES * EPOCHS / samples / 60.0
        return (now.wall - self.wall) * scale, (now.cpu - self.cpu) * scale


def recording(samples: int) -> Recording:
    """Return wandering motion of seven joints and a torque; what it is costs no time."""
    random = np.random.default_rng(0)
    t = np.arange(samples) / RATE
    angle = 2 * np.pi * t[:, None] * random.uniform(0.1, 0.4, JOINTS)
    position = np.deg2rad([10, 40, -20, -70, 30, 50, -40]) + 0.05 * np.sin(angle)
    torque = 10 * position + 0.1 * random.standard_normal(position.shape)
    return Recording.from_arrays(t, position, torque)


def trained(model: str, motion: Recording, epochs: int) -> tuple[float, float]:
    """Train for one epoch more than are timed; return the mean of those [min for the paper's]."""
    started: list[Clock] = []
    settings = replace(paper_settings(model, LENGTH), epochs=epochs + 1, device="cpu")

    def on_epoch(_: object) -> None:
        if len(started) <= epochs:
            started.append(Clock.now())
        if len(started) == epochs + 1:
            found.append(started[0].minutes(len(motion) * epochs))

    found: list[tuple[float, float]] = []
    train(Simulation("iiwa14"), [motion], settings, on_epoch)
    return found[0]


def bare_perceptrons(samples: int, epochs: int) -> tuple[float, float]:
    """Train seven perceptrons by torch on a random batch [min for the paper's]."""
    module = MlpModule(np.tile(np.arange(INPUTS), (JOINTS, 1)), HIDDEN, 1)
    optimizer = torch.optim.AdamW(module.parameters(), fused=True)
    x, y = torch.randn(BATCH, INPUTS), torch.randn(BATCH, JOINTS)
    started = Clock.now()
    for _ in range(round(TRAINED * samples / BATCH) * epochs):
        optimizer.zero_grad()
        torch.nn.functional.mse_loss(module(x), y).backward()
        torch.nn.utils.clip_grad_norm_(module.parameters(), 1.0)
        optimizer.step()
    return started.minutes(samples * epochs)


def bare_lstm(samples: int, epochs: int) -> tuple[float, float]:
    """Train torch's own LSTM and linear layer on random batches [min for the paper's]."""
    lstm, linear = torch.nn.LSTM(INPUTS, INPUTS, batch_first=True), torch.nn.Linear(INPUTS, JOINTS)
    optimizer = torch.optim.AdamW([*lstm.parameters(), *linear.parameters()], fused=True)
    x, y = torch.randn(BATCH, LENGTH, INPUTS), torch.randn(BATCH, LENGTH, JOINTS)
    steps = max(1, round(samples / (BATCH * LENGTH))) * epochs
    started = Clock.now()
    for _ in range(steps):
        optimizer.zero_grad()
        torch.nn.functional.mse_loss(linear(lstm(x)[0]), y).backward()
        optimizer.step()
    return started.minutes(steps * BATCH * LENGTH)


def main() -> None:
    """Print minutes for 100 epochs, their bar and their ratio to the bare loop."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--samples", type=int, default=100_000)
    options.add_argument("--epochs", type=int, default=2, help="that are timed")
    options.add_argument(
        "--models", nargs="+", default=["lstm-fcl", "lstm-2", "mlp7", "transformer"]
    )
    given = options.parse_args()
    torch.set_num_threads(1)
    motion = recording(given.samples)
    print(f"{given.epochs} epochs of {given.samples} samples, scaled to {EPOCHS} of {SAMPLES}")
    print("network           wall [min]  CPU [min]  bar [min]  CPU time over bare torch")
    for model in given.models:
        wall, cpu = trained(model, motion, given.epochs)
        bare = bare_perceptrons if model == "mlp7" else bare_lstm
        peer_wall, peer_cpu = bare(given.samples, given.epochs)  # beside each: the machine varies
        bar = BARS.get(model)
        print(
            f"{model:16s}  {wall:10.1f}  {cpu:9.1f}  {f'{bar:9.0f}' if bar else '        -'}  "
            f"{cpu / peer_cpu:10.2f}  (bare: wall {peer_wall:.1f}, CPU {peer_cpu:.1f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
