"""Record the simulated arms of `data/` anew: `python tests/regression/record.py`.

The recordings are stored, so that the frozen outputs do not depend on planner and simulated robot.
Whoever records anew has to freeze anew. Values are rounded far below the noise, for the size.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from frozen_cases import DATA, limo

RATE = 100  # [Hz]
PLACES = {"time": 6, "position": 6, "torque": 3}  # after the point that are kept
RECORDINGS = {  # motion, and [s] of it
    "iiwa14_explored": (("plan", "--robot", "iiwa14", "--scaffolds", 2, "--seed", 5), 40),
    "iiwa14_excited": (("excite", "--robot", "iiwa14", "--seed", 1), 20),
    "two_links": (("excite", "--robot", DATA / "two_links.urdf", "--seed", 2), 20),
}
EXCITE = ("--duration", 20, "--starts", 4, "--iterations", 20)


def record(name: str, folder: Path) -> None:
    """Plan, run and round one recording, and write it into the data."""
    plan, duration = RECORDINGS[name]
    motion, run = folder / "motion.traj.parquet", folder / "run.parquet"
    limo(*plan, *(EXCITE if plan[0] == "excite" else ()), "--out", motion)
    sim = DATA / f"{name}_true.yaml"
    options = ("--sim", sim, "--record", run, "--rate", RATE, "--duration", duration)
    limo("run", "--backend", "mujoco", "--trajectory", motion, *options)
    measured = pq.read_table(run)
    kept = {
        column: pa.array(np.round(measured[column].to_numpy(), PLACES[column.split("_")[0]]))
        for column in measured.column_names
        if column.split("_")[0] in PLACES
    }
    small = {"compression": "zstd", "compression_level": 19, "use_dictionary": False}
    pq.write_table(pa.table(kept), DATA / f"{name}.parquet", **small)


if __name__ == "__main__":
    for wanted in sys.argv[1:] or RECORDINGS:
        with TemporaryDirectory() as made:
            record(wanted, Path(made))
