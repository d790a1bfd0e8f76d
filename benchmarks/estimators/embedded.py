"""One step of a model as C beside the same in Python, and how far they are apart.

    python benchmarks/estimators/embedded.py [--steps 1000000]

Each model is exported, compiled with `-O3 -march=native`, and given the same positions and torques
as `Stream`, in turn, so that both suffer alike from whatever else the machine does.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from step import IDENTIFIED, RATE, motion, untrained

from estimators.embedded.export import export_c
from estimators.joint_physics import JointPhysics
from estimators.stream import Stream
from limo_driver.physics import PreslidingHysteresis, Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from estimators.residual_model import ResidualModel
    from limo_driver.types import FloatArray

    Estimator: TypeAlias = ResidualModel[Any] | Simulation

FLAGS = ("-std=c11", "-O3", "-march=native", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math")  # fmt: skip  # noqa: E501
ROUNDS = 5
TIMED = 4000  # steps of a round


def fitted() -> JointPhysics:
    """Return joint physics of seven joints, from a minute of motion."""
    hysteresis = PreslidingHysteresis(joint=2, stiffness=(300.0,), width=(0.004,))
    true = Simulation("iiwa14", (*IDENTIFIED.effects, hysteresis))
    moved = motion(60.0, 1)
    torque = true.predict(moved) + np.random.default_rng(0).normal(0, 0.05, moved.position.shape)
    recording = Recording.from_arrays(moved.time, moved.position, torque)
    return JointPhysics(IDENTIFIED).fit([recording])


def compiled(model: Estimator, folder: Path) -> Path:
    """Return the program that runs a model."""
    export_c(model, folder, RATE)
    program, loop = folder / "loop", Path(__file__).with_name("embedded_loop.c")
    sources = [str(loop), str(folder / "limo.c"), f"-I{folder}"]
    subprocess.run(["gcc", *FLAGS, *sources, "-o", str(program), "-lm"], check=True)
    return program


def rows_of(steps: int) -> FloatArray:
    """Return time, positions and torques of motion, (steps, 15)."""
    moved = motion(steps / RATE, 2)
    torque = IDENTIFIED.predict(moved)
    return np.ascontiguousarray(np.column_stack([moved.time, moved.position, torque]))


def of_c(program: Path, rows: FloatArray, *how: str) -> bytes:
    """Return what a program says of rows."""
    return subprocess.run(
        [program, *how], input=rows.tobytes(), capture_output=True, check=True
    ).stdout


def of_python(stream: Stream, rows: FloatArray) -> list[float]:
    """Return how long each step takes [µs]."""
    state, took = stream.init(), []
    for row in rows:
        begun = time.perf_counter()
        _, state = stream.step(state, row[0], row[1:8], row[8:])
        took.append(1e6 * (time.perf_counter() - begun))
    return took


def compare(name: str, model: Estimator, bar: float, rows: FloatArray, folder: Path) -> None:
    """Print one line of the table."""
    program, stream = compiled(model, folder), Stream(model, RATE)
    late, _ = stream.advance(stream.init(), rows[:, 0], rows[:, 1:8], rows[:, 8:])
    found = np.frombuffer(of_c(program, rows)).reshape(len(rows), 15)
    scale = np.abs(late.torque).max()
    inside = ~late.outside
    off = np.abs(found[:, :7] - late.torque)
    known = np.isfinite(late.std)
    spread = np.abs(found[:, 7:14] / late.std - 1.0)[known].max(initial=0.0)
    theirs, ours = list[list[float]](), list[float]()
    for _ in range(ROUNDS):
        said = of_c(program, rows[: 5 * TIMED], "times").decode().split()
        theirs.append([float(value) for value in said])
        ours += of_python(stream, rows[:TIMED])
    c50, c99 = np.median(theirs, axis=0)
    p50, p99 = np.percentile(ours[100:], [50, 99])
    print(
        f"{name:32}{c50:7.2f}{c99:8.2f}{bar:7.0f}{p50:9.1f}{p99:8.1f}{p50 / c50:8.1f}"
        f"{off[inside].max(initial=0.0) / scale:11.1e}{off.max() / scale:11.1e}{spread:10.1e}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=1_000_000)
    rows = rows_of(parser.parse_args().steps)
    print(f"{len(rows)} steps at {RATE:g} Hz of 7 joints, times in µs")
    print(
        f"{'':32}{'C p50':>7}{'p99':>8}{'bar':>7}{'Python':>9}{'p99':>8}{'ratio':>8}"
        f"{'torque off':>11}{'outside':>11}{'std off':>10}"
    )
    models: list[tuple[str, Estimator, float]] = [
        ("simulation alone", IDENTIFIED, 5.0),
        ("joint physics", fitted(), 5.0),
        ("LSTM-FCL 100", untrained(IDENTIFIED, "all-joints", "lstm-fcl", 100), 12.0),
        ("MLP-7", untrained(IDENTIFIED, "all-joints", "mlp7"), 12.0),
    ]
    for name, model, bar in models:
        with tempfile.TemporaryDirectory() as folder:
            compare(name, model, bar, rows, Path(folder))


if __name__ == "__main__":
    main()
