"""Diagnosis of single joints that creep, beside the fits that the authors of the data give with it.

Logs of one joint at a time whose rigid body has been taken off: what is left is the joint's own
physics. Each is diagnosed beside a joint that has next to no mass. Root mean squares of limo are of
motion held out, where the joint moves and of every row of it; those of the authors' columns are of
all rows of the log, whatever they were fitted to. Most of what limo gains on some logs is a
constant offset, which the authors' laws cannot have: so these stand there with their mean error
taken off, too. All logs that the folder has count.

    git clone --depth 1 https://github.com/longshike/NNFM-A-Novel-Neural-Network-Modeling-\
Approach-for-Robot-Flexible-Joints-Friction out/nnfm
    python benchmarks/diagnosis/creeping_joints.py "out/nnfm/Comparative data"

Columns are those of the data of "NNFM: A Novel Neural Network Modeling Approach for Robot
Flexible Joints Friction Considering Abrupt Non-smooth Properties": time [s], position of a joint,
its first and second derivative, its torque [N m], then what laws and networks make of that.
Positions of the FAIRINO there are a fiftieth of what its ripples are periodic in, as if degrees had
been converted twice, which the authors do not say; they are taken for that.
"""

from __future__ import annotations

from argparse import ArgumentParser
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.app.library.diagnosing import diagnose
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray

LAWS: Final = ("CV", "Dahl", "Stribeck", "LuGre")
NETWORK: Final = "NNFM"
UNITS: Final = {"FAIRINO Robot": float(np.degrees(1.0)), "Franka Robot": 1.0}  # by folder, to rad
POSITION, TORQUE = 1, 4  # columns
JOINT: Final = """<robot name="joint"><link name="base"/><link name="link"><inertial>
<origin xyz="0 0 0"/><mass value="0.01"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint" type="revolute"><parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="200" velocity="3"/></joint></robot>"""


@dataclass(frozen=True)
class Found:
    """What limo and the authors leave of one log, root mean squares [N m]."""

    log: str
    said: str
    moving: float  # limo's, held out, where the joint moves
    floor: float
    rows: float  # limo's, every row held out
    law: float  # the best of `LAWS`
    centred: float  # the best of them with the mean of its error taken off
    network: float

    def line(self) -> str:
        """Return a line of the table."""
        return (
            f"{self.log:38s}{self.moving:7.3f}{self.floor:7.3f}{self.rows:7.3f}{self.law:8.3f}"
            f"{self.centred:8.3f}{self.network:8.3f}  {self.said}"
        )


def found_in(path: Path, robot: Path) -> Found:
    """Diagnose one log."""
    names = [
        name for name in path.read_text(encoding="utf-8").partition("\n")[0].split(",") if name
    ]
    values = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=range(len(names)))
    told = np.isfinite(values[:, [0, POSITION, TORQUE]]).all(axis=1)
    told &= np.diff(values[:, 0], prepend=-np.inf) > 0  # a row that comes twice is no motion
    values = values[told]
    position, torque = values[:, [POSITION]] * UNITS[path.parent.name], values[:, TORQUE]
    found = diagnose(str(robot), [Recording(values[:, 0], position, torque=values[:, [TORQUE]])])
    fit = found.verdict.fit
    errors: dict[str, FloatArray] = {
        name: np.asarray(values[:, names.index(name)] - torque, dtype=float)
        for name in (*LAWS, NETWORK)
        if name in names
    }
    laws = [errors[name] for name in LAWS if name in errors]
    return Found(
        f"{path.parent.name.split()[0]} {path.stem}",
        ", ".join(item.effect for item in (*found.verdict.findings, *found.verdict.identified)),
        fit.heldout_rmse_after[0],
        fit.noise_floor[0],
        fit.heldout_rmse_after_all_rows[0],
        min(_rms(error) for error in laws),
        min(_rms(error - np.nanmean(error)) for error in laws),
        _rms(errors[NETWORK]) if NETWORK in errors else np.nan,
    )


def _rms(error: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(error**2)))


def ratios(name: str, values: Sequence[float]) -> str:
    """Return a line with the range and the median of ratios."""
    low, middle, high = np.nanmin(values), np.nanmedian(values), np.nanmax(values)
    return f"{name:44s}{low:5.2f} to {high:4.2f}, median {middle:4.2f}"


def main() -> None:
    """Diagnose the logs, and print a line of each and the ratios of all."""
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help='"Comparative data" of the authors')
    given = parser.parse_args()
    logs = sorted(path for name in UNITS for path in (given.folder / name).glob("*.csv"))
    if not logs:
        parser.error(f"no logs in {given.folder}; it needs the folders {', '.join(UNITS)}")
    print(f"{'[N m]':38s}  limo  floor  every    laws centred network")
    found: list[Found] = []
    with TemporaryDirectory() as folder:
        robot = Path(folder) / "joint.urdf"
        robot.write_text(JOINT, encoding="utf-8")
        for path in logs:
            found.append(found_in(path, robot))
            print(found[-1].line(), flush=True)
    print(f"\n{len(found)} logs; every row that limo held out, over")
    print(ratios("  the best of four laws", [item.rows / item.law for item in found]))
    print(ratios("  that without its mean error", [item.rows / item.centred for item in found]))
    print(ratios("  the authors' network", [item.rows / item.network for item in found]))


if __name__ == "__main__":
    main()
