"""Record the simulated arms of `data/` anew: `python tests/regression/record.py [NAME ...]`.

The recordings are stored, so that the frozen outputs do not depend on planner and simulated robot.
Whoever records anew has to freeze anew. Values are rounded far below the noise, for the size.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco
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
SMALL = {"compression": "zstd", "compression_level": 19, "use_dictionary": False}
SERVO_RATE, SERVO_ROWS, SOFTER = 50, 600, 0.6  # [Hz], rows of servos.parquet, gain of its elbow
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
    pq.write_table(pa.table(kept), DATA / f"{name}.parquet", **SMALL)


def record_servos() -> None:
    """Play commands on the arm behind position servos, its elbow's softer than it is believed."""
    spec = mujoco.MjSpec.from_file(str(DATA / "servos.xml"))
    spec.actuators[1].gainprm[0] *= SOFTER
    spec.actuators[1].biasprm[1] *= SOFTER
    model = spec.compile()
    arm, rows = mujoco.MjData(model), {}
    time = np.arange(SERVO_ROWS) / SERVO_RATE
    pace, phase = np.random.default_rng(4).uniform((0.5, 0.0), (5.0, 2.0 * np.pi), (4, 2, 2)).T
    command = np.round(0.35 * np.sin(time[:, None, None] * pace.T + phase.T).sum(axis=1), 5)
    position, arm.qpos[:] = np.empty_like(command), command[0]
    for row, wanted in enumerate(command):
        position[row], arm.ctrl[:] = arm.qpos, wanted
        mujoco.mj_step(model, arm, round(1.0 / SERVO_RATE / model.opt.timestep))
    for name, values in (("position", np.round(position, 5)), ("command", command)):
        rows |= {f"{name}_{j + 1}": values[:, j] for j in range(2)}
    pq.write_table(pa.table({"time": time} | rows), DATA / "servos.parquet", **SMALL)


if __name__ == "__main__":
    for wanted in sys.argv[1:] or (*RECORDINGS, "servos"):
        if wanted == "servos":
            record_servos()
            continue
        with TemporaryDirectory() as made:
            record(wanted, Path(made))
