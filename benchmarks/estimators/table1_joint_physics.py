"""Joint physics on the data and the honest split of Table I, beside the rigid body alone.

    python benchmarks/estimators/table1_joint_physics.py out/table1_real/*/data

Fitted to what run 0 of the table trains on under the split by scaffold, on the rigid body that the
table identifies from the same excitation; mean squared errors [(N m)²], mean over joints. Unlike
the table's rows, predictions go through the low-pass of 10 Hz that the measured torque goes
through, as `limo evaluate` has it; the rigid body is given in the same way.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import typer

from estimators.evaluation import evaluate
from estimators.hybrid.training.data import HELD_OUT, split_recordings
from estimators.joint_physics import JointPhysics
from estimators.studies.table1_data import RBD, TableData, rigid_body
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording


def main(folders: Annotated[list[Path], typer.Argument(help="Data folders.")]) -> None:
    """Fit joint physics to each folder and print its errors."""
    print(f"{'':44}{'training':>10}{'by scaffold':>13}{'validation':>12}")
    for folder in folders:
        data, settings = TableData.load(folder), RBD.settings()
        with tempfile.TemporaryDirectory() as prepared:
            simulation = Simulation.load(rigid_body(data, Path(prepared)))
        pieces = data.scaffolds()
        uses = split_recordings(pieces, settings.held_out, np.random.default_rng(0))
        held_out = [piece for piece, use in zip(pieces, uses, strict=True) if use[0] == HELD_OUT]
        trained = [piece for piece, use in zip(pieces, uses, strict=True) if use[0] != HELD_OUT]
        model = JointPhysics(simulation, settings.bandwidth).fit(trained)
        scores = [errors(model, part) for part in (trained, held_out, [data.validation])]
        for name, column in (("rigid body", 0), ("joint physics", 1)):
            trained_mse, test_mse, validation_mse = (score[column] for score in scores)
            print(
                f"{f'{folder.parent.name}, {name}':44}"
                f"{trained_mse:>10.4g}{test_mse:>13.4g}{validation_mse:>12.4g}"
            )


def errors(model: JointPhysics, recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the MSE of the rigid body and of joint physics, mean over joints [(N m)²]."""
    found = [evaluate(model, recording) for recording in recordings]
    counts = [int(one.scored.sum()) for one in found]
    return (
        float(np.average([one.rigid_body.mse.mean() for one in found], weights=counts)),
        float(np.average([one.hybrid.mse.mean() for one in found], weights=counts)),
    )


if __name__ == "__main__":
    typer.run(main)
