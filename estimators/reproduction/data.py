"""The recordings that Table I is made of, in one folder.

folder/
├── excitation.parquet    identifies the rigid body
├── limo.parquet          locally isotropic motion, trained and tested on
├── validation.parquet    large sinusoids of falling base frequency, never trained on
└── data.json             robot, what made the recordings, and when each scaffold is reached for
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from limo_driver.errors import ConfigError, RecordingError
from limo_driver.model import BUILT_IN, RobotModel
from limo_driver.recordings.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.types import FloatArray

SCHEMA: Final = 1
DESCRIPTION: Final = "data.json"
RECORDINGS: Final = ("excitation.parquet", "limo.parquet", "validation.parquet")
ROBOT: Final = "robot"  # in data.json, and among the digests
_REQUIRED: Final = (ROBOT, "made_by", "scaffold_starts")
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
        said = _read(folder / DESCRIPTION)
        for name in RECORDINGS:
            if not (folder / name).is_file():
                raise ConfigError(f"lacks {name}; it has to hold {_contents()}", path=folder)
        model = _robot(said[ROBOT], folder)
        excitation, limo, validation = (Recording.load(folder / name) for name in RECORDINGS)
        for recording in (excitation, limo, validation):
            recording.check_robot(model)
        if abs(validation.rate / limo.rate - 1.0) > _SAME_RATE:
            raise RecordingError(
                f"was recorded at {validation.rate:.4g} Hz, but {limo.source} at {limo.rate:.4g} "
                "Hz; expected one rate, since networks remember by samples",
                path=validation.source,
            )
        starts = _starts(said["scaffold_starts"], limo, folder / DESCRIPTION)
        digests = {name: _digest(folder / name) for name in (*RECORDINGS, DESCRIPTION)}
        if model.name not in BUILT_IN:  # what a URDF says can change while its name stays
            digests[ROBOT] = _digest(model.urdf)
        return cls(
            folder, model, str(said["made_by"]), excitation, limo, validation, starts, digests
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


def _read(path: Path) -> dict[str, Any]:
    try:
        said = json.loads(path.read_text())
    except OSError as error:
        raise ConfigError(
            f"cannot be read: {error.strerror}; a data folder holds {_contents()}", path=path
        ) from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"is no JSON: {error}", path=path) from None
    if not isinstance(said, dict) or said.get("schema") != SCHEMA:
        raise ConfigError(f"its schema is not {SCHEMA}", path=path)
    missing = [name for name in _REQUIRED if name not in said]
    if missing:
        raise ConfigError(f"lacks {', '.join(missing)}", path=path)
    return said


def _robot(given: Any, folder: Path) -> RobotModel:  # noqa: ANN401  # from JSON
    """Load a robot: built in, or a URDF, which is looked for in the folder first."""
    if not isinstance(given, str):
        raise ConfigError(
            f"robot is {given!r}, expected a built-in name or a URDF file",
            path=folder / DESCRIPTION,
        )
    beside = folder / given
    return RobotModel.load(beside if given not in BUILT_IN and beside.is_file() else given)


def _starts(given: Any, limo: Recording, path: Path) -> FloatArray:  # noqa: ANN401  # from JSON
    """Check the times at which scaffolds start."""
    try:
        starts = np.asarray(given, np.float64)
    except (TypeError, ValueError, OverflowError):
        starts = np.empty(0)
    if starts.ndim != 1 or starts.size < 2 or not np.isfinite(starts).all():  # noqa: PLR2004
        raise ConfigError("scaffold_starts: expected a list of 2 or more times [s]", path=path)
    shortest = int(np.diff(starts).argmin())
    if starts[shortest + 1] - starts[shortest] < _SHORTEST:
        raise ConfigError(
            f"scaffold_starts: {starts[shortest + 1]:g} s follows {starts[shortest]:g} s; expected "
            f"times that increase, each by {_SHORTEST:g} s or more",
            path=path,
        )
    first, last = float(limo.time[0]), float(limo.time[-1])
    if starts[0] < first or starts[-1] > last - _SHORTEST:
        raise ConfigError(
            f"scaffold_starts: span {starts[0]:g} to {starts[-1]:g} s, but {limo.source} "
            f"{first:g} to {last:g} s",
            path=path,
        )
    return starts
