"""Held-out error of limo's models on recordings of real arms, beside that of the usual model.

The folder with the recordings is named by LIMO_DATA, or is ../shared/data. Each error is the root
mean square difference between predicted and measured torque, both low-passed forward and backward
at 8 Hz (Butterworth, order 4). The usual model, fitted to the same recordings: all base parameters
and per joint viscous friction, tanh(v / 0.01), offset and armature, by least squares. Beside each
arm stands how much of the test motion comes within 0.01 rad of a pose that was trained on.

    python benchmarks/estimators/real_recordings.py [--hybrid | --physics]
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.spatial import KDTree

from estimators.evaluation import evaluate
from estimators.rigid_body import JointTerms, RigidBodyModel, Rows, identify
from limo_driver.model import RobotModel
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray

if TYPE_CHECKING:
    from limo_driver.physics import Simulation

BANDWIDTH = 8.0  # [Hz]
DATA = Path(os.environ.get("LIMO_DATA", Path(__file__).parents[2] / ".." / "shared" / "data"))
BAR = 1.05  # of the usual model, each joint
NEAR = 0.01  # [rad] of every joint, from a pose trained on

Predict = Callable[[Recording], FloatArray]


@dataclass(frozen=True)
class Case:
    """A robot, what to fit to, and what to test on."""

    name: str
    urdf: Path
    train: list[Recording]
    test: Recording
    known: tuple[Recording, ...] = ()  # what rigid bodies are fitted to, where that is not `train`

    @property
    def rigid(self) -> list[Recording]:
        """Return what rigid bodies are fitted to."""
        return list(self.known) or self.train

    @property
    def repeated(self) -> float:
        """Return the part of the test motion that is near a pose trained on."""
        trained = KDTree(np.concatenate([recording.position for recording in self.train]))
        away, _ = trained.query(self.test.position, p=np.inf)
        return float(np.mean(np.asarray(away) < NEAR))


def cases() -> Iterator[Case]:
    """Load the robots whose recordings are there."""
    lwr = [lwr4(run) for run in (1, 2, 3)]
    yield Case(
        "KUKA LWR4+, fit on runs 2 and 3, test on run 1",
        DATA / "kuka_lwr4/kuka_lwr4.urdf",
        lwr[1:],
        lwr[0],
    )
    panda = at_rate(Recording.load(DATA / "panda/exciting_trajectory.parquet"), 500.0)
    split = 2 * len(panda) // 3
    yield Case(
        "Franka Panda at 500 Hz, fit on the first two thirds, test on the last",
        panda_urdf(),
        [panda[:split]],
        panda[split:],
    )
    yield Case(
        "UR10e, fit on unloaded_14harm, test on unloaded_15harm",
        DATA / "ur10e/ur10e.urdf",
        [Recording.load(DATA / "ur10e/unloaded_14harm.parquet")],
        Recording.load(DATA / "ur10e/unloaded_15harm.parquet"),
    )


def other_motion() -> Iterator[Case]:
    """Yield the LWR4+ whose joint physics learn from one motion alone, tested on another."""
    urdf, train, test = DATA / "kuka_lwr4/kuka_lwr4.urdf", [lwr4(3)], lwr4(1)
    yield Case("KUKA LWR4+, fit on run 3, test on run 1", urdf, train, test)
    name = "KUKA LWR4+, rigid bodies fit on run 2, joint physics on run 3, test on run 1"
    yield Case(name, urdf, train, test, (lwr4(2),))


def lwr4(run: int) -> Recording:
    """Load a run of the LWR4+."""
    return Recording.load(DATA / f"kuka_lwr4/measurements_{run}.parquet")


def panda_urdf() -> Path:
    """Return the Panda of the package example-robot-data."""
    import pinocchio

    root = Path(pinocchio.__file__).parents[4]
    return root / "share/example-robot-data/robots/panda_description/urdf/panda.urdf"


def at_rate(recording: Recording, rate: float) -> Recording:
    """Return the recording at even times, linearly between its samples."""
    t = np.arange(recording.time[0], recording.time[-1], 1.0 / rate)

    def at(values: FloatArray) -> FloatArray:
        return np.stack([np.interp(t, recording.time, column) for column in values.T], axis=1)

    return Recording.from_arrays(t, at(recording.position), at(recording.torque))


def heldout_rmse(predict: Predict, recording: Recording) -> FloatArray:
    """Return the error of each joint, with the prediction filtered as the measurement is."""
    predicted = smooth(recording.time, predict(recording), BANDWIDTH, recording.segments)
    error = predicted - recording.filtered_torque(BANDWIDTH)
    return np.sqrt(np.mean(error**2, axis=0))


def usual(case: Case) -> Predict:
    """Fit the usual model."""
    rows = Rows(BANDWIDTH, False, "torque")
    return RigidBodyModel(case.urdf, JointTerms((0.01,)), rows).fit(case.rigid).predict


def models(case: Case) -> Iterator[tuple[str, Predict]]:
    """Fit each model to the case's training recordings."""
    for name, terms, rows in (
        (
            "base, sign width fitted, weights by torque",
            JointTerms(),
            Rows(BANDWIDTH, False, "torque"),
        ),
        ("base, sign width fitted, weights by error", JointTerms(), Rows(BANDWIDTH)),
    ):
        yield name, RigidBodyModel(case.urdf, terms, rows).fit(case.rigid).predict
    found = identify(RobotModel.load(case.urdf), case.rigid, rows=Rows(BANDWIDTH))
    simulation = found.simulation
    yield (
        "sim.yaml of limo identify (bodies that exist)",
        lambda recording: simulation.predict(recording, BANDWIDTH),
    )


def hybrid(case: Case) -> Iterator[tuple[str, Predict]]:
    """Train the hybrid as `limo train --features drive` does, and joint physics.

    First comes the rigid body of both.
    """
    from estimators.hybrid import HybridModel
    from estimators.hybrid.training.settings import usual_settings

    simulation = identify(RobotModel.load(case.urdf), case.rigid, rows=Rows(BANDWIDTH)).simulation
    model = HybridModel(simulation, usual_settings("drive")).fit(case.train)
    yield "rigid body of the hybrid", lambda recording: model.estimate(recording).simulation
    yield "hybrid, limo train --features drive", model.predict
    yield from physics(case, simulation)
    gains = "".join(f"{value:7.2f}" for value in model.fitted.gain)
    print(f"  {'gain of the network, from training motion':46}{gains}")


def physics(case: Case, simulation: Simulation | None = None) -> Iterator[tuple[str, Predict]]:
    """Fit joint physics as `limo train --model joint-physics` does; print what its interval holds.

    On an identified simulation, unless one is given.
    """
    from estimators.joint_physics import JointPhysics

    if simulation is None:
        found = identify(RobotModel.load(case.urdf), case.rigid, rows=Rows(BANDWIDTH))
        simulation = found.simulation
        yield "rigid body of limo identify", partial(simulation.predict, bandwidth=BANDWIDTH)
    model = JointPhysics(simulation, BANDWIDTH).fit(case.train)
    yield "joint physics, limo train --model joint-physics", model.predict
    evaluation = evaluate(model, case.test)
    for name, part in (
        ("part within its 95 % interval", evaluation.coverage),
        ("part of the motion flagged as outside", evaluation.outside),
    ):
        print(f"  {name:46}" + "".join(f"{value:7.3f}" for value in part))


def main() -> None:
    """Print each model's error beside that of the usual model."""
    parser = argparse.ArgumentParser(description=__doc__)
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--hybrid", action="store_true", help="hybrid, its rigid body, joint physics")
    only.add_argument("--physics", action="store_true", help="joint physics and its interval")
    given = parser.parse_args()
    fit = hybrid if given.hybrid else physics if given.physics else models
    if not DATA.is_dir():
        parser.error(f"no recordings in {DATA}; name their folder in LIMO_DATA")
    for case in (*cases(), *other_motion()):
        print(f"\n{case.name}: RMSE [N m], then its ratio to the usual model's")
        print(f"  {'part of the test motion near training':46}{case.repeated:7.2f}")
        baseline = heldout_rmse(usual(case), case.test)
        print(f"  {'usual model':46}" + "".join(f"{value:7.3f}" for value in baseline))
        errors: list[FloatArray] = []
        for name, predict in fit(case):
            rmse = heldout_rmse(predict, case.test)
            errors.append(rmse)
            ratio = rmse / baseline
            print(f"  {name:46}" + "".join(f"{value:7.3f}" for value in rmse))
            mean = f"mean {np.exp(np.log(ratio).mean()):.2f}, worst {ratio.max():.2f} (bar {BAR})"
            print(f"  {'':46}" + "".join(f"{value:7.2f}" for value in ratio) + f"   {mean}")
        over = errors[-1] / errors[0]
        mean = f"mean {np.exp(np.log(over).mean()):.2f}, worst {over.max():.2f}"
        print(f"  the last of these over the first: {mean}", flush=True)


if __name__ == "__main__":
    main()
