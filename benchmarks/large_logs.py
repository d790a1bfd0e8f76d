"""What a log of millions of rows costs: time and peak memory of whole commands.

    python benchmarks/large_logs.py [--kinds parquet csv npz packed.npz]
        [--commands inspect convert identify diagnose] [ROWS ...]

A log of seven joints at 1 kHz, with columns that are not limo's own, is made and goes through each
command. The bar is 2 GB, also for 10^7 rows, 2.8 h of motion. A command
that would take more than `--most` GB is ended there, and said to be.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pyarrow import csv

import limo_driver as limo

LIMO = (
    "import resource; resource.setrlimit(resource.RLIMIT_DATA, ({most}, {most})); "
    "from limo_driver.app.cli import main; main()"
)
GIGABYTES = 2.0
WRITTEN = {  # what each command writes
    "inspect": "mapping.yaml",
    "convert": "run.parquet",
    "identify": "sim.yaml",
    "diagnose": "found",
}
PIECE = 100_000  # rows that are made at once
RATE = 2 * np.pi * (0.05 + 0.02 * np.arange(7))  # [rad/s]


def piece(first: int, rows: int) -> pa.Table:
    """Return rows of motion with the torques that it needs."""
    t = 1e-3 * np.arange(first, first + rows)
    phase = np.outer(t, RATE) + np.arange(7)
    model = limo.RobotModel.load("iiwa14")
    q, v, a = 0.8 * np.sin(phase), 0.8 * RATE * np.cos(phase), -0.8 * RATE**2 * np.sin(phase)
    tau = model.inverse_dynamics(q, v, a) + 0.5 * np.tanh(v / 0.01)
    tau += np.random.default_rng(first).normal(0, 0.05, tau.shape)
    columns = {"t_ms": 1e3 * t}
    columns |= {f"q{j}": np.rad2deg(q[:, j]) for j in range(7)}
    columns |= {f"tau{j}": tau[:, j] for j in range(7)}
    return pa.table(columns)


def write(path: Path, rows: int) -> None:
    """Write a log of so many rows, as its ending says."""
    if path.suffix == ".npz":
        write_npz(path, rows)
        return
    schema = piece(0, 1).schema
    make = csv.CSVWriter if path.suffix == ".csv" else pq.ParquetWriter
    with make(path, schema) as writer:
        for first in range(0, rows, PIECE):
            writer.write_table(piece(first, min(PIECE, rows - first)))


def write_npz(path: Path, rows: int) -> None:
    """Write time, positions and torques as arrays, packed if the name says so."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        shapes = {"t_ms": (rows,), "q": (rows, 7), "tau": (rows, 7)}
        files = {name: Path(folder) / f"{name}.npy" for name in shapes}
        arrays = {
            name: np.lib.format.open_memmap(files[name], "w+", np.float64, shape)
            for name, shape in shapes.items()
        }
        for first in range(0, rows, PIECE):
            own = piece(first, min(PIECE, rows - first))
            part = slice(first, first + own.num_rows)
            arrays["t_ms"][part] = own["t_ms"].to_numpy()
            for name in ("q", "tau"):
                columns = [own[f"{name}{j}"].to_numpy() for j in range(7)]
                arrays[name][part] = np.stack(columns, axis=1)
        for array in arrays.values():
            array.flush()
        how = zipfile.ZIP_DEFLATED if "packed" in path.name else zipfile.ZIP_STORED
        with zipfile.ZipFile(path, "w", how) as packed:
            for file in files.values():
                packed.write(file, file.name)


def cost(most: float, *words: str) -> tuple[float, float, int]:
    """Run a command; return its time [s], its peak of memory [GB], and its exit status."""
    began = time.monotonic()
    with tempfile.TemporaryFile() as said:
        program = LIMO.format(most=int(most * 1e9))
        process = subprocess.Popen(
            [sys.executable, "-c", program, *words], stdout=said, stderr=said
        )
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return time.monotonic() - began, usage.ru_maxrss * 1024 / 1e9, process.returncode


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", type=int, default=[10**6, 10**7])
    parser.add_argument("--kinds", nargs="+", default=["parquet", "csv", "npz", "packed.npz"])
    parser.add_argument("--commands", nargs="+", choices=list(WRITTEN), default=list(WRITTEN))
    parser.add_argument("--most", type=float, default=6.0, help="GB that a command may take")
    asked = parser.parse_args()
    print(f"{'rows':>10} {'kind':>10} {'command':>8} {'time':>8} {'memory':>8}   bar")
    for rows in asked.rows:
        for kind in asked.kinds:
            with tempfile.TemporaryDirectory() as folder:
                log, place = Path(folder) / f"log.{kind}", Path(folder)
                write(log, rows)
                robot = ("--robot", "iiwa14", "--out")
                for name in asked.commands:
                    out = str(place / WRITTEN[name])
                    seconds, memory, status = cost(asked.most, name, str(log), *robot, out)
                    ended = f", ended with {status}" if status else ""
                    print(
                        f"{rows:>10} {kind:>10} {name:>8} {seconds:>6.1f} s {memory:>5.2f} GB   "
                        f"{GIGABYTES:g} GB{ended}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
