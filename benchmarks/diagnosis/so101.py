"""An arm that tells no torque: the SO-101's commands and positions, fitted on half of its motions.

Held out are the other motions: the closed loop is simulated forward from their commands alone, and
compared with where the arm was. Beside limo stand

- the vendor's MJCF as it is;
- a published fit of shoulder pan and lift, on these two joints, as it is and with limo's delays and
  offsets, of which it has none;
- a PACE-style fit: armature, viscous and Coulomb friction, bias and one delay of each joint by
  CMA-ES on the free-running position error, with the gains of the vendor's MJCF, and once more with
  the gain that the vendor guesses in `joints_properties.xml`;
- `mujoco.sysid` on what limo fits too, gains among it (`so101_sysid.py`), simulated by MuJoCo and
  by limo;
- limo without one of what it identified (ablation).

Every other motion by name is held out; limo was developed on this same division.
All run on the same forward simulation and the same data; one run prints one table: the error on all
rows, and on those that are not commanded into the table, which no model has. The folder with the
recordings is named by LIMO_DATA, or is ../shared/data.

    python benchmarks/diagnosis/so101.py [--minutes 10] [--peers pace,sysid] [--motions 17]
        [--alone]
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from unittest.mock import patch

os.environ.setdefault("OMP_NUM_THREADS", "1")

import mujoco
import numpy as np

from estimators.diagnosis.from_motion import diagnose_drives, free_run, identify_drives
from estimators.diagnosis.from_motion.fitting.joint import errors
from estimators.diagnosis.from_motion.simulation.constants import (
    COULOMB,
    DAMPING,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from estimators.diagnosis.from_motion.simulation.loads import loaded_joints
from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
from estimators.diagnosis.from_motion.simulation.plant import rows_of, with_rows
from limo_driver.errors import ConfigError
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
SO101 = DATA / "so101"
GUESSED = 17.8  # [N m/rad], the gain of the vendor's joints_properties.xml
DEEP = 0.04  # [m] below the base's underside, where no recorded joint follows its command
# gain [N m/rad], damping of servo and joint [N m s/rad], armature [kg m²], dry friction [N m]
PUBLISHED = ((48.4, 3.34 + 1.59, 0.068, 0.35), (47.8, 2.56 + 0.56, 0.028, 0.35))
PEERS = {"pace": "cma", "sysid": "mujoco.sysid"}  # and what each needs
REVERTED = {
    "kp": ("kp",),
    "damping": (DAMPING,),
    "dry friction": (COULOMB, "stribeck", "by_load"),
    "delay": ("delay",),
    "armature": ("inertia",),
    "offset": ("offset",),
}


def main() -> None:
    """Fit, test and print."""
    options = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    options.add_argument("--minutes", type=float, default=10.0, help="of data, for the timing")
    options.add_argument("--motions", type=int, default=17, help="of those fitted, that sysid gets")
    options.add_argument("--alone", action="store_true", help="peers, without ablation and times")
    options.add_argument("--peers", default="pace,sysid", help="that stand beside limo")
    asked = options.parse_args()
    minutes, peers = asked.minutes, asked.peers.split(",")
    for peer, needed in PEERS.items():
        if peer in peers and find_spec(needed) is None:  # told before all fits, not between
            options.error(f"{peer} needs {needed}: pip install -e .[bench]")
    vendor = Simulation.load(SO101 / "robot" / "so101_new_calib.xml")
    recordings = [Recording.load(path) for path in sorted(SO101.glob("*.parquet"))]
    seen, unseen = recordings[0::2], recordings[1::2]
    free_run(vendor, seen[0][:200])  # compiled
    print(f"{len(seen)} motions fitted, {len(unseen)} held out; mean absolute error [rad]")
    a = report("(a) vendor's MJCF as it is", vendor, unseen)
    begun = time.perf_counter()
    with counted() as rows:
        ours = identify_drives(vendor, seen, intervals=False).simulation
    spent = time.perf_counter() - begun
    limo = report(f"limo, fitted in {spent:.0f} s", ours, unseen)
    evaluations = sum(rows) // (sum(map(len, seen)) * vendor.model.n)
    by_publication(vendor, ours, unseen)
    print(f"each fit may simulate each joint {evaluations} times, what limo took", flush=True)
    if "pace" in peers:
        by_pace(vendor, seen, unseen, evaluations, limo)
    if "sysid" in peers:
        by_sysid(vendor, seen[:: -(-len(seen) // asked.motions)], unseen, evaluations, limo)
    print(f"limo is {a / limo:.2f} x better than (a), bar 2")
    if asked.alone:
        return
    for name, constants in REVERTED.items():
        report(f"limo with {name} as stated", reverted(ours, vendor, constants), unseen)
    speed(ours, unseen)
    timing(vendor, recordings, 60.0 * minutes)


def by_publication(vendor: Simulation, ours: Simulation, unseen: Sequence[Recording]) -> None:
    """Print the errors of the published fit's two joints over limo's."""
    few, known = slice(len(PUBLISHED)), rows_of(ours)
    rows, later = rows_of(vendor), rows_of(vendor)
    for j, values in enumerate(PUBLISHED):
        published = dict(zip(("kp", DAMPING, "inertia", COULOMB), values, strict=True))
        rows[j] = with_values(rows[j], {"kd": 0.0, **published})
        later[j] = with_values(rows[j], {x: value_in(known[j], x) for x in ("delay", "offset")})
    limo = _error(ours, unseen).mean(axis=0)[few]
    for name, own in (("as it is", rows), ("with limo's delays and offsets", later)):
        theirs = _error(with_rows(vendor, list(own)), unseen).mean(axis=0)[few]
        each = "  ".join(f"{a:.5f} / {b:.5f}" for a, b in zip(theirs, limo, strict=True))
        print(f"the published fit {name} errs {theirs.mean() / limo.mean():.2f} times as much "
              f"as limo (bar 1), joints 1 and 2: {each}", flush=True)  # fmt: skip


def _error(simulation: Simulation, recordings: Sequence[Recording]) -> FloatArray:
    """Return how far each joint is off, (rows, n) [rad]."""
    return np.concatenate([np.abs(free_run(simulation, r) - r.position) for r in recordings])


def by_pace(
    vendor: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    evaluations: int,
    limo: float,
) -> None:
    """Fit both PACE-style models and print their errors over limo's."""
    begun = time.perf_counter()
    b = report("(b) PACE-style, gains of the MJCF", pace(vendor, seen, evaluations), unseen)
    servos = tuple(replace(drive, kp=GUESSED, kd=0.0) for drive in vendor.drives)
    guessed = pace(replace(vendor, drives=servos), seen, evaluations)
    better = report(f"(b') PACE-style, gain {GUESSED}", guessed, unseen)
    print(f"both PACE-style fits took {time.perf_counter() - begun:.0f} s")
    if np.isfinite(b):
        print(f"limo is {b / limo:.2f} x better than (b), bar 1.3")
    print(f"limo is {better / limo:.2f} x better than (b'), whose gain is nearly right")


def by_sysid(
    vendor: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    evaluations: int,
    limo: float,
) -> None:
    """Fit by `mujoco.sysid` and print its errors over limo's."""
    from so101_sysid import sysid

    begun = time.perf_counter()
    found = sysid(vendor, seen, evaluations)
    spent = time.perf_counter() - begun
    own = found.errors(unseen)
    joints = "  ".join(f"{value:.5f}" for value in np.abs(own).mean(axis=0))
    c = float(np.abs(own).mean())
    print(f"{'(c) mujoco.sysid, simulated by MuJoCo':40s} {c:.5f}   joints {joints}", flush=True)
    report("(c) its values simulated by limo", found.simulation, unseen)
    print(f"sysid took {spent:.0f} s for {found.simulated} simulations of {len(seen)} motions")
    print(f"limo is {c / limo:.2f} x better than (c)")


def report(name: str, simulation: Simulation, recordings: Sequence[Recording]) -> float:
    """Print the errors of each joint and their mean, and return that [rad]."""
    try:
        error = _error(simulation, recordings)
    except ConfigError as reason:
        print(f"{name:40s} cannot be simulated: {reason}", flush=True)
        return float("nan")
    joints = "  ".join(f"{value:.5f}" for value in error.mean(axis=0))
    free = error[~np.concatenate([into_table(r) for r in recordings])]
    print(
        f"{name:40s} {error.mean():.5f}   joints {joints}   {free.mean():.5f} on the "
        f"{len(free) / len(error):.0%} of rows that are not commanded into the table",
        flush=True,
    )
    return float(error.mean())


@cache
def _shapes() -> tuple[Any, dict[int, FloatArray]]:
    """Return the vendor's arm, and the corners of each mesh of it, (K, 3) [m] by geometry."""
    model = mujoco.MjModel.from_xml_path(str(SO101 / "robot" / "so101_new_calib.xml"))
    way = np.random.default_rng(0).normal(size=(200, 3))
    corners: dict[int, FloatArray] = {}
    for geom in np.flatnonzero(model.geom_dataid >= 0).tolist():
        mesh = model.geom_dataid[geom]
        first, many = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        points = np.asarray(model.mesh_vert[first : first + many], dtype=float)
        corners[geom] = points[np.unique((points @ way.T).argmax(axis=0))]
    return model, corners


def into_table(recording: Recording) -> NDArray[np.bool_]:
    """Return the rows, (T,), whose command is `DEEP` below the base, and those of the next second.

    No model's error has a part in this: the table is in none of them.
    """
    model, corners = _shapes()
    data, every = mujoco.MjData(model), 10
    moved = {geom: own for geom, own in corners.items() if model.geom_bodyid[geom] > 2}
    mujoco.mj_kinematics(model, data)
    base = min(_lowest(data, g, own) for g, own in corners.items() if model.geom_bodyid[g] == 1)
    command = commands_of(recording)
    deep = np.zeros(len(recording), dtype=bool)
    for row in range(0, len(recording), every):
        data.qpos[: recording.n] = command[row]
        mujoco.mj_kinematics(model, data)
        deep[row : row + every] = min(_lowest(data, *own) for own in moved.items()) < base - DEEP
    late = round(recording.rate)
    return np.convolve(deep, np.ones(late + 1))[: deep.size] > 0.5


def _lowest(data: Any, geom: int, corners: FloatArray) -> float:  # noqa: ANN401  # no stubs
    """Return the height of the lowest of a geometry's corners [m]."""
    turned = corners @ np.asarray(data.geom_xmat[geom]).reshape(3, 3).T
    return float(turned[:, 2].min() + data.geom_xpos[geom, 2])


@contextmanager
def counted() -> Generator[list[int]]:
    """Count the rows of each simulation of one joint."""
    rows, simulate = list[int](), LoadedJoint.simulate

    def simulated(part: LoadedJoint, row: FloatArray) -> FloatArray:
        rows.append(part.time.size)
        return simulate(part, row)

    with patch.object(LoadedJoint, "simulate", simulated):
        yield rows


# Of the logarithms fitted, at least: of armature [kg m²], below which no free run settles
_LOW: Final = (np.log(1e-2), -12.0, -12.0, -12.0)


def pace(simulation: Simulation, recordings: Sequence[Recording], evaluations: int) -> Simulation:
    """Fit armature, viscous and Coulomb friction, bias and one delay of each joint by CMA-ES."""
    parts, rows = loaded_joints(simulation.body, recordings), rows_of(simulation)
    with ThreadPoolExecutor() as pool:
        of_joint = partial(_pace_joint, evaluations=evaluations)
        return with_rows(simulation, list(pool.map(of_joint, parts, rows)))


def _pace_joint(parts: Sequence[LoadedJoint], row: FloatArray, evaluations: int) -> FloatArray:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import cma

    def of(x: FloatArray) -> FloatArray:
        inertia, damping, coulomb, delay = np.exp(np.clip(x[:4], _LOW, 5.0)).tolist()
        return with_values(
            row,
            {
                "inertia": inertia,
                DAMPING: damping,
                COULOMB: coulomb,
                "delay": min(delay, 0.5),
                "offset": float(x[4]),
            },
        )

    start = np.append(np.log([0.03, 0.6, 0.1, 0.02]), 0.0)
    search = cma.CMAEvolutionStrategy(
        start, 0.5, {"maxfevals": evaluations, "verbose": -9, "seed": 1}
    )

    def cost(x: FloatArray) -> float:
        return 1e4 * float(np.mean(errors(parts, of(x)) ** 2))

    search.optimize(cost)
    return of(np.array(search.result.xbest))


def reverted(ours: Simulation, vendor: Simulation, constants: Sequence[str]) -> Simulation:
    """Return limo's simulation with some constants as the vendor states them."""
    rows, stated = rows_of(ours), rows_of(vendor)
    mixed = [
        with_values(own, {name: value_in(theirs, name) for name in constants})
        for own, theirs in zip(rows, stated, strict=True)
    ]
    return with_rows(ours, mixed)


def speed(simulation: Simulation, recordings: Sequence[Recording]) -> None:
    """Print how fast the whole arm is simulated forward."""
    begun = time.process_time()
    for recording in recordings:
        free_run(simulation, recording)
    spent = time.process_time() - begun
    duration = sum(recording.duration for recording in recordings)
    print(f"forward at {duration / spent:.0f} x real time of one core, bar 100")


def timing(simulation: Simulation, recordings: Sequence[Recording], wanted: float) -> None:
    """Print how long a diagnosis of so many seconds of data takes."""
    chosen: list[Recording] = []
    for recording in recordings:
        if sum(item.duration for item in chosen) < wanted:
            chosen.append(recording)
    begun, used = time.perf_counter(), time.process_time()
    found = diagnose_drives(simulation, chosen)
    wall, cpu = time.perf_counter() - begun, time.process_time() - used
    duration = sum(item.duration for item in chosen) / 60
    print(f"{duration:.1f} min diagnosed in {wall:.0f} s, {cpu:.0f} s of processor; bar 60 s")
    print(found)


if __name__ == "__main__":
    main()
