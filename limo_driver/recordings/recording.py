"""Recording: measured joint motion and torque in order of time, checked as it is read."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limo_driver.errors import RecordingError, ShapeError
from limo_driver.model import RobotModel
from limo_driver.recordings import checks
from limo_driver.recordings.channels import (
    CHANNELS,
    Columns,
    channels_of,
    chosen,
    of_numbers,
    seconds,
    without_wraps,
)
from limo_driver.recordings.files.batches import STRETCH, STRETCH_SECONDS, Stretches
from limo_driver.recordings.filters.filtered_samples import FilteredSamples
from limo_driver.recordings.gate.doubts import (
    LeftOut,
    UsableRows,
    with_one_clock,
    without_silent_torques,
)
from limo_driver.recordings.gate.rows import inspect, inspect_by_joint
from limo_driver.runtime.display import Displayed
from limo_driver.types import FloatArray, readonly

__all__ = ["Columns", "LeftOut", "Recording"]


@dataclass(frozen=True, repr=False)
class Recording(FilteredSamples, Displayed):
    """T usable samples of n joints.

    Velocity is kept as the robot gave it; `motion` computes velocity and acceleration from the
    positions, with a stated bandwidth. Make one with `load` or `from_arrays`, which check the data.

    Args:
        time: (T,) [s], strictly increasing.
        position: (T, n) [rad].
        torque: Measured, (T, n) [N m].
        velocity: As recorded, (T, n) [rad/s]; None where it was not.
        extras: What else was measured of each joint, by name, (T, n) each; temperature in °C.
        source: File it was read from, for messages.
        rows: Row of the file of each sample, (T,); counted from 0 if not given.
        rows_total: Rows of the file.
        left_out: Rows that cannot be used, with the reasons.
        warnings: What a user should know of the rows that were kept.
        robot: Name of the robot that was recorded; empty where the file does not say it.
        torque_resolution: Step of each joint's measured torque, (n,) [N m]; None if not known.
        unmeasured: (T, n) true where a torque is no measurement; None where all are. Only
            `by_joint` returns such recordings, and logs that hold commands and no torque.
        command: In force at each sample, (T, n), in the unit of each joint's channel: set-points
            [rad], or velocities [rad/s]; None where none was recorded.
        channels: Of the command of each joint, as its columns are named; set-points of positions
            (`command`), if empty.
        spread: Rows of a long log of which the samples are evenly spread stretches; 0 if they are
            all of it.
        partial: The same with the rows on which the torque of some joint alone is none, for
            `by_joint`; None where there are no others.

    Raises:
        ShapeError: The shapes do not fit together, or there is no joint.
        RecordingError: A time, position or torque is no finite number, or time does not increase.
            `load` and `from_arrays` leave such rows out, and take other units of time.

    Example:
        >>> time = np.arange(0.0, 4.0, 0.004)
        >>> position = 0.5 + 0.3 * np.sin(np.pi * time)[:, None] * np.ones(7)
        >>> torque = limo.RobotModel.load("iiwa14").gravity_torque(position)
        >>> recording = limo.Recording.from_arrays(time, position, torque)
        >>> recording.motion(10.0).acceleration
    """

    time: FloatArray  # (T,) [s], strictly increasing
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray  # (T, n) [N m], measured
    velocity: FloatArray | None = None  # (T, n) [rad/s], as recorded
    extras: Mapping[str, FloatArray] = field(default_factory=dict)  # e.g. temperature, (T, n)
    source: str = ""
    rows: NDArray[np.int64] | None = None  # (T,) row of the file of each sample
    rows_total: int = 0  # rows of the file
    left_out: tuple[LeftOut, ...] = ()
    warnings: tuple[str, ...] = ()  # what a user should know of the rows that were kept
    robot: str = ""  # name of the robot that was recorded, where the file says it
    torque_resolution: FloatArray | None = None  # (n,) [N m], step of each joint's torque; or None
    unmeasured: NDArray[np.bool_] | None = None  # (T, n), torques that are no measurement
    command: FloatArray | None = None  # (T, n) [rad], or what the joint's channel has
    channels: tuple[str, ...] = ()  # of the commands, by joint
    spread: int = 0  # rows of the log of which these are stretches; 0 if they are all
    partial: Recording | None = field(default=None, compare=False)  # rows of some joints, too

    def __post_init__(self) -> None:
        shape = np.shape(self.position)
        by_name = {"torque": self.torque, "velocity": self.velocity, "command": self.command}
        checks.check_shapes(self.time, self.position, by_name | dict(self.extras))
        checks.check_seconds(self.time, self.source)
        for name in ("time", "position", "torque", "velocity", "command"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, readonly(getattr(self, name)))
        object.__setattr__(self, "extras", {k: readonly(v) for k, v in self.extras.items()})
        rows = np.arange(shape[0]) if self.rows is None else np.asarray(self.rows, np.int64)
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "rows_total", self.rows_total or shape[0])
        if rows.shape != shape[:1]:
            raise ShapeError("rows", rows.shape, f"({shape[0]},)")
        if (step := self.torque_resolution) is not None and np.shape(step) != shape[1:]:
            raise ShapeError("torque_resolution", np.shape(step), f"({shape[1]},)")
        checks.check_values(self.time, self.position, self.torque, self.source)
        object.__setattr__(self, "channels", channels_of(self.channels, shape[1]))

    @classmethod
    def load(cls, path: Path | str) -> Recording:
        """Read Parquet, CSV or limo's own log.

        Rows that cannot be used are left out and named in `left_out`; nothing is repaired. Of more
        than a million rows, evenly spread stretches are read, and `spread` and `warnings` say so.

        Args:
            path: Its ending says what it is.

        Raises:
            RecordingError: Names what cannot be used, where, and what was expected.
        """
        from limo_driver.recordings.files.recording_file import read_columns

        columns = read_columns(Path(path))
        try:
            return cls._checked(columns, str(path))
        except RecordingError as error:
            raise RecordingError(str(error), path=path, rows=error.rows) from None

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        position: ArrayLike,
        torque: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        extras: Mapping[str, ArrayLike] | None = None,
        source: str = "",
        command: ArrayLike | None = None,
        channels: tuple[str, ...] = (),
    ) -> Recording:
        """Check arrays as `load` checks a file.

        Args:
            time: (T,) [s]; also dates, or whole micro- or nanoseconds, of which `warnings` tells.
            position: (T, n) [rad].
            torque: Measured, (T, n) [N m]; not needed beside commands.
            velocity: (T, n) [rad/s], where it was recorded.
            extras: What else was measured of each joint, by name, (T, n) each.
            source: Where it is from, for messages.
            command: In force at each sample, (T, n) [rad], or as `channels` say.
            channels: Of the command of each joint: `command` [rad], `command_velocity` [rad/s] or
                `command_torque` [N m]; the first, if empty.

        Raises:
            RecordingError: The data cannot be used, or hold neither torques nor commands.
            ShapeError: An array has another shape than the positions.
        """
        counted, taken = _seconds(time)
        measured = checks.numbers("position", position)
        if torque is None and command is None:
            raise RecordingError("holds neither torques nor commands, expected either or both")
        columns = Columns(
            counted,
            measured,
            np.full_like(measured, np.nan) if torque is None else checks.numbers("torque", torque),
            None if velocity is None else checks.numbers("velocity", velocity),
            {name: checks.numbers(name, values) for name, values in (extras or {}).items()},
            warnings=(taken,) if taken else (),
            command=None if command is None else checks.numbers("command", command),
            channels=channels,
        )
        return cls.from_columns(columns, source)

    @classmethod
    def from_columns(cls, columns: Columns, source: str = "") -> Recording:
        """Check columns in SI units as `load` checks those of a file.

        Args:
            columns: Before any row is judged.
            source: Where they are from, for messages.

        Raises:
            RecordingError: The data cannot be used.
            ShapeError: An array has another shape than the positions.
        """
        by_name = {
            "torque": columns.torque,
            "velocity": columns.velocity,
            "command": columns.command,
            **columns.extras,
        }
        checks.check_shapes(columns.time, columns.position, by_name)
        return cls._checked(columns, source)

    @classmethod
    def _checked(cls, columns: Columns, source: str) -> Recording:
        columns = with_one_clock(without_wraps(of_numbers(columns)))
        if columns.command is not None and np.isnan(columns.torque).all():
            return cls._without_torque(columns, source)
        columns = without_silent_torques(columns)
        recording = cls._of(columns, inspect(columns), source)
        if not np.isfinite(columns.torque).all() or any(
            item.reason.startswith("torque_") for item in recording.left_out
        ):
            found = inspect_by_joint(columns)
            if found is not None:
                filled, usable, none = found
                more = replace(cls._of(filled, usable, source), unmeasured=none[usable.rows])
                return replace(recording, partial=more)
        return recording

    @classmethod
    def _without_torque(cls, columns: Columns, source: str) -> Recording:
        """Return what commands and positions alone say; its torques are 0 and marked."""
        columns = replace(columns, torque=np.zeros_like(columns.position))
        recording = cls._of(columns, inspect(columns), source)
        none = np.ones(recording.position.shape, dtype=bool)
        return replace(recording, unmeasured=none)

    @classmethod
    def _of(cls, columns: Columns, findings: UsableRows, source: str) -> Recording:
        rows = findings.rows
        return cls(
            time=columns.time[rows],
            position=columns.position[rows],
            torque=columns.torque[rows],
            velocity=None if columns.velocity is None else columns.velocity[rows],
            extras={name: values[rows] for name, values in columns.extras.items()},
            source=source,
            rows=rows,
            rows_total=columns.time.size,
            left_out=findings.left_out,
            warnings=(*columns.warnings, *findings.warnings),
            robot=columns.robot,
            torque_resolution=columns.torque_resolution,
            command=None if columns.command is None else columns.command[rows],
            channels=columns.channels,
            spread=columns.spread,
        )

    @property
    def has_torque(self) -> bool:
        """Whether any torque was measured."""
        return self.unmeasured is None or not bool(self.unmeasured.all())

    @property
    def measured_joints(self) -> NDArray[np.bool_]:
        """Which joints' torque was measured, (n,).

        One that is the same in all rows is none, but where all are, as coarse sensors show an arm
        at rest.
        """
        changes = np.ptp(self.torque, axis=0) > 0
        return np.asarray((changes | ~changes.any()) & self.has_torque, dtype=bool)

    def measured_torque(self, bandwidth: float) -> FloatArray:
        """Filter the torque, as what a prediction is held against.

        Args:
            bandwidth: As for `motion` [Hz].

        Returns:
            Filtered torques, (T, n) [N m]; NaN for joints whose torque was not measured.

        Raises:
            RecordingError: None was measured, all are 0, or the bandwidth is too high for the
                sampling rate.
        """
        if self.has_torque and not np.any(self.torque):
            raise RecordingError(
                "every torque is 0 N m; was it measured?", path=self.source or None
            )
        return np.where(self.measured_joints, self.filtered_torque(bandwidth), np.nan)

    def check_torque(self) -> None:
        """Check that torques were measured.

        Raises:
            RecordingError: None was.
        """
        if not self.has_torque:
            raise RecordingError(
                "lacks torque_1: it holds commands and positions alone, which only identify, "
                "diagnose and a free-running prediction can use",
                path=self.source or None,
            )

    def by_joint(self) -> Recording:
        """Return also the rows on which the torque of some joint alone is no measurement.

        For what judges each joint by itself: one bad channel does not take the rows of all joints.
        Torques marked in `unmeasured` may not be used. Only a recording that was loaded or made
        from arrays knows of such rows; cuts of it return themselves.
        """
        return self if self.partial is None else self.partial

    def save(self, path: Path | str) -> None:
        """Write Parquet that `load` reads back, without the rows that were left out.

        Args:
            path: To be written; its ending is .parquet, .pq or none.

        Raises:
            ConfigError: It cannot be written, or its ending is that of another format.
        """
        from limo_driver.recordings.files.recording_file import write_columns

        columns = Columns(
            self.time,
            self.position,
            self._measured_torque(),
            self.velocity,
            dict(self.extras),
            robot=self.robot,
            torque_resolution=self.torque_resolution,
            command=self.command,
            channels=self.channels,
        )
        write_columns(columns, Path(path))

    def _measured_torque(self) -> FloatArray:
        """Return the torque, (T, n) [N m]; NaN for joints whose 0 stands for none."""
        if not self.has_torque:
            return np.full_like(self.torque, np.nan)
        known = self.torque.any(axis=0)
        return np.where(known, self.torque, np.nan) if known.any() else self.torque

    def headline(self) -> str:
        """Say how long it is, how fast, of what, and what was left out."""
        rate = f" at {self.rate:.4g} Hz" if len(self) > 1 else ""
        text = f"{self.duration:.4g} s, {len(self)} samples{rate} of {self.n} joints"
        text += f" of {self.robot}" if self.robot else ""
        out = self.rows_total - len(self)
        text += f", {out} rows left out" if out else ""
        text += f", stretches of {self.spread} rows" if self.spread else ""
        return text + (f", from {self.source}" if self.source else "")

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the range of position and torque of each joint."""
        if not len(self):
            return {}
        return {
            "joint": range(1, self.n + 1),
            "from [rad]": self.position.min(axis=0).tolist(),
            "to [rad]": self.position.max(axis=0).tolist(),
            "least torque [N m]": self.torque.min(axis=0).tolist(),
            "most torque [N m]": self.torque.max(axis=0).tolist(),
        }

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.position.shape[1]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]; 0 if there is none."""
        return float(np.ptp(self.time)) if len(self) else 0.0

    @property
    def rate(self) -> float:
        """Median sampling rate [Hz].

        Raises:
            RecordingError: There are fewer than two samples.
        """
        if len(self) < 2:  # noqa: PLR2004
            raise RecordingError(
                f"is too short to have a rate: samples {len(self)}, expected 2 or more",
                path=self.source or None,
            )
        return 1.0 / float(np.median(np.diff(self.time)))

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.int64]) -> Recording:
        """Return the samples in `rows`: a slice, a mask, or increasing indices."""
        assert self.rows is not None  # noqa: S101  # set in __post_init__
        return replace(
            self,
            time=self.time[rows],
            position=self.position[rows],
            torque=self.torque[rows],
            velocity=None if self.velocity is None else self.velocity[rows],
            extras={name: values[rows] for name, values in self.extras.items()},
            rows=self.rows[rows],
            unmeasured=None if self.unmeasured is None else self.unmeasured[rows],
            command=None if self.command is None else self.command[rows],
            partial=None,
        )

    def led(self, wanted: Sequence[str | None]) -> Recording:
        """Return the same with the commands that drives take.

        Args:
            wanted: Channel of each joint's drive, as its columns are named; None where any will do.

        Raises:
            RecordingError: It has commands, and not those that a drive takes.
        """
        if self.command is None and not self.extras.keys() & CHANNELS.keys():
            return self
        command, channels = chosen(self.command, self.channels, self.extras, wanted, self.source)
        return replace(self, command=command, channels=channels, partial=None)

    def at_most(self, rows: int) -> Recording:
        """Return evenly spread stretches of it; itself, if it has no more samples than that.

        Args:
            rows: Samples that may be kept, at least one stretch of `STRETCH_SECONDS`.
        """
        if len(self) <= rows:
            return self
        stretch = min(STRETCH, math.ceil(STRETCH_SECONDS * self.rate))
        stride = math.ceil(math.ceil(len(self) / stretch) / max(rows // stretch, 1))
        stretches = Stretches[NDArray[np.int64]](
            lambda piece, a, b: piece[a:b], max(rows, stretch), stretch, stride
        )
        stretches.add(np.arange(len(self)), len(self))
        if not stretches.spread:  # one stretch holds all of it
            return self
        kept = self[np.concatenate(stretches.pieces())]
        warnings = (*self.warnings, stretches.note())
        return replace(kept, warnings=warnings, spread=self.spread or len(self))

    def check_robot(self, model: RobotModel) -> None:
        """Check that the recording can be of this robot.

        Args:
            model: The robot.

        Raises:
            RecordingError: Other name, joint count, or positions that the joints cannot reach; or
                there is no sample.
        """
        checks.check_arm(model, self.position, self.torque, self.robot, self.source)


def _seconds(time: ArrayLike) -> tuple[FloatArray, str]:
    values = np.asarray(time)
    return seconds(values) if values.dtype.kind in "iumM" else (checks.numbers("time", time), "")
