"""Joint physics against LSTM-FCL 500 with tau_RBD and r, on the same motion: MSE, ratios and bars.

    python benchmarks/estimators/table1_data.py --out out/table1/data
    python benchmarks/estimators/joint_physics.py --data out/table1/data --lstm out/table1/lstm
    python benchmarks/estimators/joint_physics.py --data out/table1/data \
        --lstm out/table1/lstm --tenth

Every fifth scaffold is test motion, which nothing is fitted to; both models learn from the others,
on a rigid body identified on excitation.parquet, and --tenth leaves joint physics a tenth of all
scaffolds. The LSTM is trained by the paper's protocol, which takes minutes, or read from the folder
if one is there. Test and validation motion are scored as they are used: memory runs on. Where a
scaffold begins, both have seen the ten seconds before. All torques are scored behind one filter.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from estimators.base import DEVIATIONS
from estimators.evaluation import noise_floor
from estimators.hybrid import HybridModel
from estimators.joint_physics import JointPhysics
from estimators.model_folder import check_simulation
from estimators.rigid_body import identify
from limo_driver.model import RobotModel
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from limo_driver.physics import Simulation
    from limo_driver.types import FloatArray

BANDWIDTH = 10.0  # [Hz]
TEST_EVERY, TENTH_EVERY = 5, 10  # scaffolds
LEAD = 10.0  # [s] of motion before what is scored
BARS = {"test": 0.5, "validation": 0.3}  # of the LSTM's mean MSE
BAR_TENTH = 1.0
COVERAGE = (0.92, 0.98)


@dataclass(frozen=True)
class Data:
    """The recordings, and which scaffold each sample of the LIMO motion is of."""

    excitation: Recording
    limo: Recording
    validation: Recording
    robot: str
    scaffold: np.ndarray  # (T,)

    @classmethod
    def load(cls, folder: Path) -> Data:
        """Read the folder of table1_data.py."""
        names = ("excitation", "limo", "validation")
        excitation, limo, validation = (Recording.load(folder / f"{n}.parquet") for n in names)
        described = json.loads((folder / "data.json").read_text())
        scaffold = np.searchsorted(described["scaffold_starts"], limo.time, side="right") - 1
        return cls(excitation, limo, validation, described["robot"], np.maximum(scaffold, 0))

    def training(self, *, tenth: bool) -> Recording:
        """Return the scaffolds to learn from, with gaps between them."""
        use = self.scaffold % TEST_EVERY != TEST_EVERY - 1
        return self.limo[use & (self.scaffold % TENTH_EVERY == 0) if tenth else use]

    def test(self) -> list[tuple[Recording, np.ndarray]]:
        """Return each test scaffold with the motion before it, and which samples are scored."""
        pieces: list[tuple[Recording, np.ndarray]] = []
        for number in range(TEST_EVERY - 1, int(self.scaffold.max()) + 1, TEST_EVERY):
            own = np.flatnonzero(self.scaffold == number)
            first = np.searchsorted(self.limo.time, self.limo.time[own[0]] - LEAD)
            piece = self.limo[int(first) : int(own[-1]) + 1]
            scored = ~piece.edges(BANDWIDTH) & (piece.time >= self.limo.time[own[0]])
            pieces.append((piece, scored))
        return pieces


@dataclass(frozen=True)
class Scores:
    """Of one model on one kind of motion, per joint (n,)."""

    mse: FloatArray  # [(N m)²]
    simulation: FloatArray  # [(N m)²], MSE of its rigid body with Coulomb and viscous friction
    coverage: FloatArray
    outside: FloatArray

    @classmethod
    def of(
        cls, model: JointPhysics | HybridModel, pieces: list[tuple[Recording, np.ndarray]]
    ) -> Scores:
        """Score a model on the samples that count."""
        errors, alone, within, outside = [], [], [], []
        for recording, use in pieces:
            measured = recording.filtered_torque(BANDWIDTH)[use]
            found = model.estimate(recording).filtered(recording, BANDWIDTH)
            errors.append(measured - found.torque[use])
            alone.append(measured - found.simulation[use])
            within.append(np.abs(errors[-1]) <= DEVIATIONS * found.std[use])
            outside.append(found.outside[use])
        return cls(
            np.mean(np.concatenate(errors) ** 2, axis=0),
            np.mean(np.concatenate(alone) ** 2, axis=0),
            np.mean(np.concatenate(within), axis=0),
            np.mean(np.concatenate(outside), axis=0),
        )


def lstm(folder: Path, simulation: Simulation, training: Recording) -> HybridModel:
    """Return LSTM-FCL 500 with tau_RBD and r, from the folder or trained into it."""
    from estimators.hybrid.training.settings import paper_settings

    if folder.is_dir():
        model = HybridModel.load(folder)
        check_simulation(model, simulation)
        return model
    # all of the training motion but one sub-sequence: the test scaffolds judge
    settings = replace(paper_settings("lstm-fcl", 500), held_out=1e-4, split="sequences")
    start = time.perf_counter()
    model = HybridModel(simulation, settings).fit([training])
    print(f"LSTM-FCL 500 trained in {time.perf_counter() - start:.0f} s", flush=True)
    model.save(folder)
    return model


def line(name: str, values: FloatArray, form: str = "9.5f", average: bool = True) -> None:
    """Print one row of figures per joint, and their mean."""
    mean = f"{values.mean():{form}}" if average else ""
    print(f"  {name:34}" + "".join(f"{value:{form}}" for value in values) + mean)


def main() -> None:
    """Print the figures of both models beside the bars."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder of table1_data.py")
    parser.add_argument("--tenth", action="store_true", help="learn from a tenth of the scaffolds")
    parser.add_argument("--lstm", type=Path, help="folder of the LSTM, trained if not there")
    parser.add_argument(
        "--excitation", action="store_true", help="learn from excitation.parquet as well"
    )
    given = parser.parse_args()
    data = Data.load(given.data)
    simulation = identify(RobotModel.load(data.robot), [data.excitation]).simulation
    training = data.training(tenth=given.tenth)
    start = time.perf_counter()
    own = JointPhysics(simulation, BANDWIDTH).fit(
        [training, data.excitation] if given.excitation else [training]
    )
    seconds = time.perf_counter() - start
    print(f"joint physics fitted to {len(training)} samples in {seconds:.1f} s", flush=True)
    network = lstm(given.lstm, simulation, data.training(tenth=False)) if given.lstm else None
    validation = ~data.validation.edges(BANDWIDTH)
    motions = {"test": data.test(), "validation": [(data.validation, validation)]}
    for name, pieces in motions.items():
        found = Scores.of(own, pieces)
        print(f"\n{name}: MSE [(N m)²] of joints 1 to {found.mse.size} and their mean")
        line("rigid body, Coulomb, viscous", found.simulation)
        line("joint physics", found.mse)
        line("noise left by the filter", noise_floor(pieces[0][0], BANDWIDTH) ** 2)
        if network is not None:
            peer = Scores.of(network, pieces)
            bar = BAR_TENTH if given.tenth else BARS[name]
            ratio = found.mse.mean() / peer.mse.mean()
            line("LSTM-FCL 500 with tau_RBD, r", peer.mse)
            line("joint physics / LSTM", found.mse / peer.mse, average=False)
            verdict = "reached" if ratio <= bar else "missed"
            print(f"  ratio of the means {ratio:.3f} (bar {bar:g}: {verdict})")
        line("part within the 95 % interval", found.coverage, "9.3f")
        inside = (found.coverage >= COVERAGE[0]) & (found.coverage <= COVERAGE[1])
        verdict = "reached" if inside.all() else "missed"
        print(f"  every joint within {COVERAGE[0]:g} to {COVERAGE[1]:g}: {verdict}")
        line("part of motion flagged outside", found.outside, "9.3f")


if __name__ == "__main__":
    main()
