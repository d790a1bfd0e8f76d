"""The recordings that Table I is made of, in one folder.

folder/
├── excitation.parquet    identifies the rigid body
├── limo.parquet          locally isotropic motion, trained and tested on
├── validation.parquet    large sinusoids of falling base frequency, never trained on
└── data.json             robot, what made the recordings, and when each scaffold is reached for
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, RecordingError
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.model.robot_model import beside
from limo_driver.recordings.recording import Recording
from limo_driver.runtime.declarations import read_json
from limo_driver.runtime.parameters import Parameter

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.runtime.declarations import Given
    from limo_driver.types import FloatArray

SCHEMA: Final = 1
DESCRIPTION: Final = "data.json"
RECORDINGS: Final = ("excitation.parquet", "limo.parquet", "validation.parquet")
ROBOT: Final = "robot"  # in data.json, and among the digests
_REQUIRED: Final = (ROBOT, "made_by", "scaffold_starts")
_STARTS: Final = Parameter("scaffold_starts", "s", is_list=True)
_SAME_RATE: Final = 0.05
_SHORTEST: Final = 1.0  # [s] of a scaffold, so that its motion can be filtered and scored


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
        said = read_json(folder / DESCRIPTION, ConfigError, SCHEMA).needs(*_REQUIRED)
        for name in RECORDINGS:
            if not (folder / name).is_file():
                raise ConfigError(f"lacks {name}; it has to hold {_contents()}", path=folder)
        model = RobotModel.load(beside(said.text(ROBOT), folder))
        excitation, limo, validation = (Recording.load(folder / name) for name in RECORDINGS)
        for recording in (excitation, limo, validation):
            recording.check_robot(model)
        if abs(validation.rate / limo.rate - 1.0) > _SAME_RATE:
            raise RecordingError(
                f"was recorded at {validation.rate:.4g} Hz, but {limo.source} at {limo.rate:.4g} "
                "Hz; expected one rate, since networks remember by samples",
                path=validation.source,
            )
        starts = _starts(said["scaffold_starts"], limo)
        digests = {name: _digest(folder / name) for name in (*RECORDINGS, DESCRIPTION)}
        if model.name not in BUILT_IN:  # what a URDF says can change while its name stays
            digests[ROBOT] = _digest(model.urdf)
        return cls(
            folder,
            model,
            str(said["made_by"].content),
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


def _contents() -> str:
    return ", ".join((*RECORDINGS, DESCRIPTION))


def _digest(path: Path) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _starts(given: Given, limo: Recording) -> FloatArray:
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
