"""Write the recordings of real arms as folders of `limo reproduce table1 --data`.

The folder with the recordings is named by LIMO_DATA, or is ../shared/data.

    python benchmarks/estimators/table1_real_data.py --out out/table1_real
    limo reproduce table1 --data out/table1_real/ur10e/data --out out/table1_real/ur10e --runs 1

None of these arms played LIMOPA motion, and each recording is one motion without scaffolds. So
"scaffold_starts" cut what networks learn from into equal stretches, as short as LONG_ENOUGH allows
and a sub-sequence of 500 samples still finds room. The LWR4+ has two folders: its validation
repeats the commands of run 2, so that only networks trained on run 3 are validated on other motion.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from real_recordings import DATA, cases

if TYPE_CHECKING:
    from limo_driver.recordings.recording import Recording

BANDWIDTH = 10.0  # [Hz] of the table's filter
LONGEST_SEQUENCE = 500  # samples, T of the table
LONG_ENOUGH = 2.5  # [s] of a stretch: its middle is not next to anything that was trained on
# Folder → which of the case's training recordings identifies and which trains, and what made them.
ROLES = (
    {
        "kuka_lwr4": (1, 0, "a KUKA LWR4+: rigid body from run 3, networks on run 2, validated on "
        "run 1, the commands of run 2 again"),
        "kuka_lwr4_new_motion": (0, 1, "a KUKA LWR4+: rigid body from run 2, networks on run 3, "
        "validated on run 1, the commands of run 2"),
    },
    {"panda": (0, 0, "a Franka Panda: rigid body and networks from the first two thirds of a "
    "recording at 500 Hz, validated on the last")},
    {"ur10e": (0, 0, "a UR10e, torque from motor currents: rigid body and networks from "
    "unloaded_14harm, validated on unloaded_15harm")},
)  # fmt: skip


def main(
    out: Annotated[Path, typer.Option(help="Folder to write a folder of each arm to.")] = Path(
        "out/table1_real"
    ),
) -> None:
    """Write a data folder for each arm."""
    if not DATA.is_dir():
        raise typer.BadParameter(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    for case, roles in zip(cases(), ROLES, strict=True):
        for name, (identifying, training, made_by) in roles.items():
            folder = out / name / "data"
            folder.mkdir(parents=True, exist_ok=True)
            limo = case.train[training]
            starts = equal_stretches(limo)
            case.train[identifying].save(folder / "excitation.parquet")
            limo.save(folder / "limo.parquet")
            case.test.save(folder / "validation.parquet")
            shutil.copyfile(case.urdf, folder / f"{name}.urdf")
            length = limo.duration / len(starts)
            described = {
                "schema": 1,
                "robot": f"{name}.urdf",
                "made_by": f"{made_by}; scaffolds are equal stretches of {length:.1f} s",
                "scaffold_starts": starts,
            }
            (folder / "data.json").write_text(json.dumps(described, indent=1) + "\n")
            print(f"{folder}: {len(limo)} samples, {len(starts)} stretches of {length:.1f} s")


def equal_stretches(limo: Recording) -> list[float]:
    """Return when each of as many stretches as can be begins [s]; all have as many samples."""
    ends = int(limo.edges(BANDWIDTH).sum())  # whose derivatives are unsure, at every cut again
    count = min(int(limo.duration / LONG_ENOUGH), len(limo) // (LONGEST_SEQUENCE + ends + 1))
    return limo.time[np.arange(count) * len(limo) // count].tolist()


if __name__ == "__main__":
    typer.run(main)
