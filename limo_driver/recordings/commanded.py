"""Commanded: commands that were recorded, and where the arm was at first; for simulating it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.recordings.checks import check_arm
from limo_driver.recordings.gate import LeftOut, about_gaps, inspect_commands
from limo_driver.recordings.recording import Recording
from limo_driver.types import readonly

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.recordings.columns import Columns
    from limo_driver.types import FloatArray

_MOST: Final = 0.5  # of the rows, that have positions where commands can be held against them
_STILL: Final = 2e-3  # [rad], range of positions that stand for none


@dataclass(frozen=True)
class Commanded:
    """T set-points of n joints, and where the arm was at the first of them.

    Rows are judged by time and commands: positions behind the first have no say in what is
    simulated, and may be missing.
    """

    time: FloatArray  # (T,) [s], strictly increasing
    command: FloatArray  # (T, n) [rad], each in force until the next
    start: FloatArray  # (n,) [rad], recorded at the first of these rows
    rows: NDArray[np.int64]  # (T,) row of the file of each
    rows_total: int  # rows of the file
    left_out: tuple[LeftOut, ...] = ()
    warnings: tuple[str, ...] = ()
    source: str = ""
    robot: str = ""  # as the file names it, if it does
    recorded: Recording | None = None  # what commands can be held against, if that was recorded

    def __post_init__(self) -> None:
        for name in ("time", "command", "start"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def __len__(self) -> int:
        return self.time.size

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.start.size

    @classmethod
    def from_columns(cls, columns: Columns, source: str = "") -> Commanded:
        """Take what is needed of columns in SI units.

        Args:
            columns: Before any row is judged.
            source: Where they are from, for messages.

        Raises:
            RecordingError: There are no commands, or no position to start from; times or commands
                cannot be used, nor positions where most rows have them.
        """
        if columns.command is None:
            raise _lacking(
                "lacks command_1: without the set-points of its drives, a motion", source
            )
        usable = inspect_commands(columns)
        placed = np.asarray(np.isfinite(columns.position).all(axis=1))
        first = np.flatnonzero(placed[usable.rows])
        if not first.size:
            raise _lacking(
                "no row has a position of all joints: without the first one, a motion", source
            )
        rows = usable.rows[first[0] :]
        before = tuple(usable.rows[: first[0]].tolist())
        none = (LeftOut("no position was recorded yet", before),) if before else ()
        recorded = None
        if placed.mean() > _MOST:
            no_torque = np.full_like(columns.position, np.nan)
            recorded = Recording.from_columns(replace(columns, torque=no_torque), source)
        return cls(
            columns.time[rows],
            columns.command[rows],
            columns.position[rows[0]],
            rows,
            columns.time.size,
            (*usable.left_out, *none),
            (*columns.warnings, *_about_gaps(columns.time[rows])),
            source,
            columns.robot,
            _moved(recorded),
        )

    @classmethod
    def of(cls, recording: Recording) -> Commanded:
        """Take what is needed of a recording, of which all rows are usable.

        Raises:
            RecordingError: It has no commands.
        """
        assert recording.rows is not None  # noqa: S101  # set as it is made
        source = recording.source
        if recording.command is None:
            raise _lacking(
                "lacks command_1: without the set-points of its drives, a motion", source
            )
        return cls(
            recording.time,
            recording.command,
            recording.position[0],
            recording.rows,
            recording.rows_total,
            recording.left_out,
            recording.warnings,
            source,
            recording.robot,
            _moved(recording),
        )

    def check_robot(self, model: RobotModel) -> None:
        """Check that the commands can be of this robot, from where it was at first.

        Raises:
            RecordingError: Other name or joint count, or a first position that the joints cannot
                reach.
        """
        start = self.start[None, :]
        check_arm(model, start, np.zeros_like(start), self.robot, self.source)


def _lacking(what: str, source: str) -> RecordingError:
    return RecordingError(f"{what} cannot be simulated forward", path=source or None)


def _moved(recording: Recording | None) -> Recording | None:
    """Return a recording, if its positions are any: not those of an arm that was never read."""
    if recording is None or recording.command is None:
        return None
    position = recording.position
    told = np.array_equal(position, recording.command)
    return None if told or np.ptp(position, axis=0).max() < _STILL else recording


def _about_gaps(time: FloatArray) -> list[str]:
    return [f"{text}; the command before stays in force" for text in about_gaps(time)]
