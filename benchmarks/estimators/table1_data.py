"""Make the recordings on which Table I is reproduced: a lifelike arm under the paper's motions.

    python benchmarks/estimators/table1_data.py --out out/table1/data
    python benchmarks/estimators/table1_data.py --scaffolds 15 --out out/table1/data_small

The arm is drawn from the seed; it lives in tests/concealed and shares no code with limo. Written
are excitation.parquet (a minute that identifies the rigid body), limo.parquet (LIMOPA with 150
scaffolds, 804 205 samples as in the paper), validation.parquet (large sinusoids of falling base
frequency), and data.json, which says where each scaffold's part begins. Each begins at rest.
"""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import typer

from estimators.rigid_body.base_parameters import Conditioning
from limo_driver.model import RobotModel
from limopa import ExcitationRequest, PlanRequest, excite, plan
from limopa.planner import REACHING

CONCEALED = Path(__file__).parents[2] / "tests" / "concealed"
SAMPLES, SCAFFOLDS = 804_205, 150  # of the paper, in about an hour
PERIOD = 1e-3  # [s] of the plant
SEED = 2022
VALIDATION = (20.0, 30.0, 45.0, 60.0, 90.0, 120.0)  # [s], periods of the base frequencies


def main(
    out: Annotated[Path, typer.Option(help="Folder to write.")] = Path("out/table1/data"),
    scaffolds: Annotated[int, typer.Option(help="Of LIMOPA motion, 24 to 28 s each.")] = SCAFFOLDS,
    seed: Annotated[int, typer.Option(help="Of the arm and all motions.")] = SEED,
) -> None:
    """Make the three recordings of one arm."""
    sys.path.insert(0, str(CONCEALED))
    import lifelike
    from acquisition import Instruments

    random = np.random.default_rng([seed, 1])
    world, instruments = lifelike.draw(random), Instruments.draw(random)
    model = RobotModel.load("iiwa14")
    limo = plan(model, PlanRequest(scaffolds=scaffolds), seed).trajectory
    samples = SAMPLES * scaffolds / SCAFFOLDS
    instruments = replace(instruments, rate=(samples - 0.5) / limo.duration, jitter=0.0)
    starts = [float(limo.time[max(s.start - 1, 0)]) for s in limo.segments if s.kind == REACHING]
    motions = {
        "excitation": excite(model, Conditioning(model), seed=seed).trajectory.resample(PERIOD),
        "limo": limo.resample(PERIOD),
        "validation": None,
    }
    out.mkdir(parents=True, exist_ok=True)
    for number, (name, motion) in enumerate(motions.items()):
        position = _sinusoids(model, seed) if motion is None else motion.position
        response = world.respond(position, 0, np.random.default_rng([seed, 2, number]))
        recorded = instruments.record(response, world.sensing, number)
        columns = {"time": recorded.time}
        for j in range(position.shape[1]):
            columns[f"position_{j + 1}"] = recorded.position[:, j]
            columns[f"torque_{j + 1}"] = recorded.torque[:, j]
        pq.write_table(pa.table(columns), out / f"{name}.parquet")
        print(f"{name}: {recorded.time.size} samples, {recorded.time[-1]:.0f} s", flush=True)
    described = {"schema": 1, "robot": "iiwa14", "made_by": f"concealed arm {seed}"}
    text = json.dumps(described | {"scaffold_starts": starts}, indent=1)
    (out / "data.json").write_text(text + "\n")


def _sinusoids(model: RobotModel, seed: int) -> np.ndarray:
    """Join excitations, each slower than the one before, by moves from rest to rest."""
    import arm
    import motions

    random, limits, parts = np.random.default_rng([seed, 3]), arm.load()[1], []
    for number, duration in enumerate(VALIDATION):
        request = ExcitationRequest(duration=duration, starts=8, iterations=30)
        found = excite(model, Conditioning(model), request, seed + number + 1).trajectory
        made = found.resample(PERIOD).position
        if parts:
            parts.append(motions.move(parts[-1][-1], made[0], limits, random.uniform(0.2, 0.5)))
        parts.append(made)
    return np.concatenate(parts)


if __name__ == "__main__":
    typer.run(main)
