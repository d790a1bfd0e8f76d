"""Table I: its rows, the data that they are computed from, and the rigid body beneath all.

The recordings that Table I is made of, in one folder.

folder/
├── excitation.parquet    identifies the rigid body
├── limo.parquet          locally isotropic motion, trained and tested on
├── validation.parquet    large sinusoids of falling base frequency, never trained on
└── data.json             robot, what made the recordings, and when each scaffold is reached for
"""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import yaml

from estimators.hybrid.training.settings import TrainingSettings, paper_settings
from estimators.rigid_body import identify
from limo_driver.errors import ConfigError, RecordingError
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.model.robot_model import beside
from limo_driver.physics import Simulation
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.declarations import ConfigNode, read_json
from limo_driver.runtime.parameters import Parameter
from limo_driver.types import FloatArray

SCHEMA: Final = 1
DESCRIPTION: Final = "data.json"
RECORDINGS: Final = ("excitation.parquet", "limo.parquet", "validation.parquet")
ROBOT: Final = "robot"  # in data.json, and among the digests
_REQUIRED: Final = (ROBOT, "made_by", "scaffold_starts")
_STARTS: Final = Parameter("scaffold_starts", "s", is_list=True)
_SAME_RATE: Final = 0.05
_SHORTEST: Final = 1.0  # [s] of a scaffold, so that its motion can be filtered and scored
_DIGITS: Final = 10  # of the digest in a file name
PERCEPTRON: Final = "mlp7"  # of `TrainingSettings`
PARTS: Final = ("training", "test", "validation")
PAPER_JOINTS: Final = 7
_COLUMNS: Final = (*(f"joint_{j}" for j in range(1, PAPER_JOINTS + 1)), "joint_average")
HISTORY: Final = "rotation_since_reversal"  # r of the paper


@dataclass(frozen=True)
class TableData:
    """A data folder, read and checked."""

    folder: Path
    model: RobotModel
    made_by: str
    excitation: Recording
    limo: Recording
    validation: Recording
    scaffold_starts: FloatArray  # (L,) [s], when the reach for each scaffold begins, of `limo`
    digests: Mapping[str, str]  # sha256 of each file, and of the robot's if it is not built in

    @classmethod
    def load(cls, folder: Path) -> TableData:
        """Read a data folder.

        Raises:
            ConfigError: A file is missing, or data.json cannot be used; the message says where.
            RecordingError: A recording is of another robot, or of another rate than the others.
        """
        description = read_json(folder / DESCRIPTION, ConfigError, SCHEMA).needs(*_REQUIRED)
        for name in RECORDINGS:
            if not (folder / name).is_file():
                held = ", ".join((*RECORDINGS, DESCRIPTION))
                raise ConfigError(f"lacks {name}; it has to hold {held}", path=folder)
        model = RobotModel.load(beside(description.text(ROBOT), folder))
        excitation, limo, validation = (Recording.load(folder / name) for name in RECORDINGS)
        for recording in (excitation, limo, validation):
            recording.check_robot(model)
        if abs(validation.rate / limo.rate - 1.0) > _SAME_RATE:
            raise RecordingError(
                f"was recorded at {validation.rate:.4g} Hz, but {limo.source} at {limo.rate:.4g} "
                "Hz; expected one rate, since networks remember by samples",
                path=validation.source,
            )
        starts = _starts(description["scaffold_starts"], limo)
        digests = {name: _digest(folder / name) for name in (*RECORDINGS, DESCRIPTION)}
        if model.name not in BUILT_IN:  # what a URDF says can change while its name stays
            digests[ROBOT] = _digest(model.urdf)
        return cls(
            folder,
            model,
            str(description["made_by"].content),
            excitation,
            limo,
            validation,
            starts,
            digests,
        )

    @property
    def robot(self) -> str:
        """Name of the robot: built in, or the URDF's file without its ending."""
        return self.model.name if self.model.name in BUILT_IN else self.model.urdf.stem

    def scaffolds(self) -> tuple[Recording, ...]:
        """Cut `limo` into one recording for each scaffold: its reach and what explores it.

        What was recorded before the first reach belongs to the first.
        """
        cuts = np.searchsorted(self.limo.time, self.scaffold_starts[1:])
        return tuple(
            self.limo[slice(int(start), int(stop))]
            for start, stop in pairwise([0, *cuts, len(self.limo)])
        )


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _starts(given: ConfigNode, limo: Recording) -> FloatArray:
    """Read the times at which scaffolds start."""
    starts = np.array(given.value(_STARTS))
    if starts.size < 2:  # noqa: PLR2004
        given.refuse("a list of 2 or more times [s]")
    shortest = int(np.diff(starts).argmin())
    if starts[shortest + 1] - starts[shortest] < _SHORTEST:
        given.fail(
            f"{starts[shortest + 1]:g} s follows {starts[shortest]:g} s; expected times that "
            f"increase, each by {_SHORTEST:g} s or more"
        )
    first, last = float(limo.time[0]), float(limo.time[-1])
    if starts[0] < first or starts[-1] > last - _SHORTEST:
        given.fail(
            f"span {starts[0]:g} to {starts[-1]:g} s, but {limo.source} {first:g} to {last:g} s"
        )
    return starts


def rigid_body(data: TableData, folder: Path) -> Path:
    """Identify base parameters with Coulomb and viscous friction from the excitation.

    Args:
        data: Holds the excitation and names the robot.
        folder: Where the simulation is kept; one that is there already is taken.

    Returns:
        The sim.yaml.

    Raises:
        RecordingError: The excitation says too little.
    """
    of = (RECORDINGS[0], DESCRIPTION, ROBOT)
    known = "".join(data.digests[name] for name in of if name in data.digests)
    path = folder / f"rigid_body-{sha256(known.encode()).hexdigest()[:_DIGITS]}.yaml"
    if not path.exists():
        identify(data.model, [data.excitation]).simulation.save(path)
    return path


def physics_digest(simulation: Path) -> str:
    """Return the sha256 of what a sim.yaml says of inertias and joints, wherever its robot lies.

    Raises:
        ConfigError: It cannot be read, or is no simulation.
    """
    Simulation.load(simulation)  # refuses by name what is none
    content = yaml.safe_load(simulation.read_text(encoding="utf-8"))
    del content["robot"]  # a path relative to the file, which may have moved with its data
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True)
class Row:
    """One architecture with one choice of inputs; named as in the paper's table."""

    name: str
    model: str | None  # of `TrainingSettings`; None: the rigid body alone
    sequence_length: int = 100  # T, of the network's memory and of the sub-sequences that are split
    rigid_body: bool = True  # tau_RBD among the inputs and added to the output
    history: bool = True  # r among the inputs
    layers: int = 0  # 0: the paper's
    hidden: int = 0  # 0: the paper's

    def settings(self) -> TrainingSettings:
        """Return the paper's protocol for this row; that of the rigid body only says how to split.

        Raises:
            ConfigError: The network cannot be trained.
        """
        settings = paper_settings(
            self.model or PERCEPTRON,
            self.sequence_length,
            without=() if self.history else (HISTORY,),
            standalone=not self.rigid_body,
        )
        return replace(
            settings, layers=self.layers or settings.layers, hidden=self.hidden or settings.hidden
        )


ALONE: Final = {"rigid_body": False, "history": False}

RBD: Final = Row("RBD", None)
MLP: Final = Row("MLP-7", PERCEPTRON, **ALONE)
MLP_HYBRID: Final = Row("MLP-7 with tau_rbd", PERCEPTRON, history=False)
MLP_FULL: Final = Row("MLP-7 with tau_rbd,r", PERCEPTRON)
LSTM2: Final = Row("LSTM-2 100", "lstm-2", **ALONE)
LSTM2_HYBRID: Final = Row("LSTM-2 100 with tau_rbd", "lstm-2", history=False)
LSTM2_FULL: Final = Row("LSTM-2 100 with tau_rbd,r", "lstm-2")
FCL100: Final = Row("LSTM-FCL 100", "lstm-fcl", **ALONE)
FCL100_HISTORY: Final = Row("LSTM-FCL 100 with r", "lstm-fcl", rigid_body=False)
FCL100_FULL: Final = Row("LSTM-FCL 100 with tau_rbd,r", "lstm-fcl")
FCL500: Final = Row("LSTM-FCL 500", "lstm-fcl", 500, **ALONE)
FCL500_HYBRID: Final = Row("LSTM-FCL 500 with tau_rbd", "lstm-fcl", 500, history=False)
FCL500_FULL: Final = Row("LSTM-FCL 500 with tau_rbd,r", "lstm-fcl", 500)
TRANSFORMER: Final = Row("Transformer 500 with tau_rbd,r", "transformer", 500)

ROWS: Final = (
    *(RBD, MLP, MLP_HYBRID, MLP_FULL, LSTM2, LSTM2_HYBRID, LSTM2_FULL),
    *(FCL100, FCL100_HISTORY, FCL100_FULL, FCL500, FCL500_HYBRID, FCL500_FULL, TRANSFORMER),
)
MORE: Final = tuple(Row(f"{model.upper()} 100 with tau_rbd,r", model) for model in ("gru", "lru"))
ALL_ROWS: Final = ROWS + MORE  # those that the paper lacks stand last

_BEST: Final = (1, 35)  # layers and width of the row of the table whose topology is varied

TOPOLOGIES: Final = {
    (layers, hidden): FCL500_FULL
    if (layers, hidden) == _BEST
    else replace(
        FCL500_FULL, name=f"{FCL500_FULL.name}, {layers} x {hidden}", layers=layers, hidden=hidden
    )
    for layers in (1, 2)
    for hidden in (15, 35, 55)
}


@cache
def paper_table() -> dict[tuple[str, str], FloatArray]:
    """Return the paper's figures: part and row → MSE of joints 1 to 7 and average, (8,) [(N m)²].

    All are as printed; a few of the averages are not the mean of the seven figures beside them.

    Source: Çallar and Böttger, RA-L 2022, Table I.
    """
    text = (files("estimators.studies") / "paper_table1.csv").read_text(encoding="utf-8")
    lines = (line for line in text.splitlines() if not line.startswith("#"))
    return {
        (row["split"], row["architecture"]): np.array([float(row[name]) for name in _COLUMNS])
        for row in csv.DictReader(lines)
    }
