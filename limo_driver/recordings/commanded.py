"""Commanded: commands that were recorded, and where the arm was at first; for simulating it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from limo_driver.errors import RecordingError
from limo_driver.model import RobotModel
from limo_driver.recordings.channels import POSITION, Columns, channels_of, chosen, commanded_by
from limo_driver.recordings.checks import check_arm
from limo_driver.recordings.gate.doubts import LeftOut, about_gaps, with_one_clock
from limo_driver.recordings.gate.rows import inspect_commands
from limo_driver.recordings.recording import Recording
from limo_driver.types import FloatArray, readonly

_MOST: Final = 0.5  # of the rows, that have positions where commands can be held against them
_STILL: Final = 2e-3  # [rad], range of positions that stand for none


@dataclass(frozen=True)
class Commanded:
    """T set-points of n joints, and where the arm was at the first of them.

    Rows are judged by time and commands: positions behind the first have no say in what is
    simulated, and may be missing. Make one with `of`.

    Args:
        time: (T,) [s], strictly increasing.
        command: (T, n), each in force until the next, in the unit of each joint's channel: [rad]
            where that is `command`, [rad/s] where it is `command_velocity`, [N m] where it is
            `command_torque`.
        start: (n,) [rad], recorded at the first of these rows.
        rows: Row of the file of each, (T,).
        rows_total: Rows of the file.
        left_out: Rows that cannot be used, with the reasons.
        warnings: What a user should know of the rows that were kept.
        source: File it was read from, for messages.
        robot: Name of the robot that was commanded; empty where the file does not say it.
        channels: Of the command of each joint; `command`, if empty.
        others: What else was recorded of each joint, by name, (T, n) each.
        recorded: What commands can be held against; None where no motion was recorded.

    Raises:
        RecordingError: There are no commands, or no position to start from (`of`,
            `from_columns`).

    Example:
        >>> told = limo.Commanded.of(limo.read("commanded.parquet"))
        >>> limo.predict_forward("servos.yaml", told)
    """

    time: FloatArray
    command: FloatArray
    start: FloatArray
    rows: NDArray[np.int64]
    rows_total: int
    left_out: tuple[LeftOut, ...] = ()
    warnings: tuple[str, ...] = ()
    source: str = ""
    robot: str = ""
    recorded: Recording | None = None
    channels: tuple[str, ...] = ()
    others: Mapping[str, FloatArray] = field(default_factory=dict[str, "FloatArray"])

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", channels_of(self.channels, self.start.size))
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

        Returns:
            All rows with a time and commands, from the first that has a position.

        Raises:
            RecordingError: There are no commands, or no position to start from; times or commands
                cannot be used, nor positions where most rows have them.
        """
        columns = with_one_clock(columns)
        command = set_points(columns.command, source)
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
            command[rows],
            columns.position[rows[0]],
            rows,
            columns.time.size,
            (*usable.left_out, *none),
            (*columns.warnings, *_about_gaps(columns.time[rows])),
            source,
            columns.robot,
            _moved(recorded),
            columns.led,
            {name: values[rows] for name, values in columns.extras.items()},
        )

    @classmethod
    def of(cls, recording: Recording) -> Commanded:
        """Take what is needed of a recording, of which all rows are usable.

        Args:
            recording: T samples of n joints, with commands.

        Returns:
            Its commands, and its first position.

        Raises:
            RecordingError: It has no commands.
        """
        assert recording.rows is not None  # noqa: S101  # set as it is made
        source = recording.source
        command = set_points(recording.command, source)
        return cls(
            recording.time,
            command,
            recording.position[0],
            recording.rows,
            recording.rows_total,
            recording.left_out,
            recording.warnings,
            source,
            recording.robot,
            _moved(recording),
            recording.channels,
            recording.extras,
        )

    def led(self, wanted: Sequence[str | None]) -> Commanded:
        """Return the same with the commands that drives take.

        Args:
            wanted: Channel of each joint's drive; None where any will do.

        Raises:
            RecordingError: One was not recorded.
        """
        command, channels = chosen(self.command, self.channels, self.others, wanted, self.source)
        recorded = None if self.recorded is None else self.recorded.led(wanted)
        return replace(self, command=command, channels=channels, recorded=recorded)

    def check_robot(self, model: RobotModel) -> None:
        """Check that the commands can be of this robot, from where it was at first.

        Args:
            model: The robot.

        Raises:
            RecordingError: Other name or joint count, or a first position that the joints cannot
                reach.
        """
        start = self.start[None, :]
        check_arm(model, start, np.zeros_like(start), self.robot, self.source)


def set_points(command: FloatArray | None, source: str) -> FloatArray:
    """Return the set-points of a recording.

    Args:
        command: As it has them, (T, n) [rad]; None where it has none.
        source: Where it is from, for messages.

    Raises:
        RecordingError: It has none.
    """
    if command is None:
        raise _lacking("lacks command_1: without the set-points of its drives, a motion", source)
    return command


def _lacking(what: str, source: str) -> RecordingError:
    return RecordingError(f"{what} cannot be simulated forward", path=source or None)


def _moved(recording: Recording | None) -> Recording | None:
    """Return a recording, if its positions are any: not those of an arm that was never read."""
    if recording is None or recording.command is None:
        return None
    position = recording.position
    placed = commanded_by(POSITION, recording.channels).all()
    told = placed and np.array_equal(position, recording.command)
    return None if told or np.ptp(position, axis=0).max() < _STILL else recording


def _about_gaps(time: FloatArray) -> list[str]:
    return [f"{text}; the command before stays in force" for text in about_gaps(time)]
