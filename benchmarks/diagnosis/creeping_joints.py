"""Diagnosis of single joints that creep, beside the fits that the authors of the data give with it.

Logs of one joint at a time whose rigid body has been taken off: what is left is the joint's own
physics. Each is diagnosed beside a joint that has next to no mass. Root mean squares of limo are of
motion held out, where the joint moves and of every row of it; those of the authors' columns are of
all rows of the log, whatever they were fitted to.

    python benchmarks/diagnosis/creeping_joints.py verify_robot_S_slow_processed.csv --degrees-twice
    python benchmarks/diagnosis/creeping_joints.py case3_slow.csv case4_slow.csv

Columns are those of the data of "NNFM: A Novel Neural Network Modeling Approach for Robot
Flexible Joints Friction Considering Abrupt Non-smooth Properties" (longshike, GitHub): time [s],
position of a joint, its first and second derivative, its torque [N m], then what laws and
networks make of that. Positions of the FAIRINO there are a fiftieth of what its ripples are
periodic in: as if degrees had been converted twice.
"""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Final

import numpy as np

from limo_driver.recordings.recording import Recording
from limo_driver.workflow.diagnosing import diagnose

LAWS: Final = ("CV", "Dahl", "Stribeck", "LuGre")
NETWORK: Final = "NNFM"
POSITION, TORQUE = 1, 4  # columns
JOINT: Final = """<robot name="joint"><link name="base"/><link name="link"><inertial>
<origin xyz="0 0 0"/><mass value="0.01"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="200" velocity="3"/></joint></robot>"""


def row(path: Path, robot: Path, *, degrees_twice: bool) -> str:
    """Diagnose one log; return a line of the table."""
    names = [
        name for name in path.read_text(encoding="utf-8").partition("\n")[0].split(",") if name
    ]
    values = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=range(len(names)))
    time = values[:, 0]
    told = np.isfinite(values[:, [0, POSITION, TORQUE]]).all(axis=1)
    told &= np.diff(time, prepend=-np.inf) > 0  # a row that comes twice is no motion
    values = values[told]
    position = values[:, [POSITION]] * (np.degrees(1.0) if degrees_twice else 1.0)
    torque = values[:, TORQUE]
    begun = process_time()
    found = diagnose(str(robot), [Recording(values[:, 0], position, torque=values[:, [TORQUE]])])
    taken, fit = process_time() - begun, found.verdict.fit
    others = {
        name: float(np.sqrt(np.nanmean((values[:, names.index(name)] - torque) ** 2)))
        for name in (*LAWS, NETWORK)
        if name in names
    }
    best = min((others[name], name) for name in LAWS if name in others)
    said = [*found.verdict.findings, *found.verdict.identified]
    return (
        f"{path.stem:32s} {fit.heldout_rmse_before[0]:6.3f} -> {fit.heldout_rmse_after[0]:6.3f} "
        f"(floor {fit.noise_floor[0]:.3f})  every row {fit.heldout_rmse_after_all_rows[0]:6.3f}  "
        f"{best[1]} {best[0]:6.3f}  {NETWORK} {others.get(NETWORK, np.nan):6.3f}  {taken:4.0f} s  "
        f"{', '.join(item.effect for item in said)}"
    )


def main() -> None:
    """Diagnose the logs, and print a line of each."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--degrees-twice", action="store_true", help="positions are a 57th")
    given = parser.parse_args()
    print(
        "[N m] given -> improved (noise floor), every row held out; their best law, their network"
    )
    with TemporaryDirectory() as folder:
        robot = Path(folder) / "joint.urdf"
        robot.write_text(JOINT, encoding="utf-8")
        for path in given.logs:
            print(row(path, robot, degrees_twice=given.degrees_twice), flush=True)


if __name__ == "__main__":
    main()
