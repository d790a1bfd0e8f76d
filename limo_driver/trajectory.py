"""Trajectory: joint motion that is commanded, and its Parquet file."""

# pyright: reportUnknownParameterType=false
# pyarrow ships no stubs.

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from math import perm
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from limo_driver.errors import ConfigError, PathError, ShapeError
from limo_driver.runtime import written_by
from limo_driver.runtime.given_files import check_file
from limo_driver.types import FloatArray, JointLimits, Motion, as_numbers, same_robot

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pyarrow as pa
    from numpy.typing import NDArray


_METADATA_KEY = b"limo.trajectory"
_QUANTITIES = ("position", "velocity", "acceleration")
LONGEST_STEP = 10.0  # [s] from one sample to the next
LONGEST = 8 * 3600.0  # [s]; at 1 kHz, eight hours of seven joints already take gigabytes
LARGEST = 1e6  # [rad, rad/s, rad/s^2]; no arm does more, and the quintics stay finite
_BLOCK = 16_384  # rows evaluated at once: bounds the memory of an hour at 1 kHz


@dataclass(frozen=True)
class Segment:
    """A stretch of a trajectory: rows `start` to `stop` (exclusive)."""

    kind: str  # for example reaching, exploring
    start: int
    stop: int


@dataclass(frozen=True)
class Peaks:
    """Largest absolute values of a motion for each joint; (n,)."""

    velocity: FloatArray  # [rad/s]
    acceleration: FloatArray  # [rad/s^2]
    jerk: FloatArray  # [rad/s^3]

    def over(self, limits: JointLimits) -> Peaks:
        """Return the same relative to the limits of the joints."""
        return Peaks(
            self.velocity / limits.velocity,
            self.acceleration / limits.acceleration,
            self.jerk / limits.jerk,
        )


@dataclass(frozen=True, repr=False)
class Trajectory(Motion):
    """Commanded joint motion; between samples it is the quintic through both neighbours.

    The quintic takes position, velocity and acceleration of the two samples, so the motion is
    twice continuously differentiable at any control rate.

    Args:
        time: (T,) [s], increasing, in steps of 10 s at most.
        position: (T, n) [rad].
        velocity: (T, n) [rad/s].
        acceleration: (T, n) [rad/s^2].
        temperature: Of no use to a commanded motion.
        robot: Name of the robot it was planned for; empty for any that has n joints.
        segments: What the stretches of it are for, such as exploring.
        source: File it was read from, for messages.

    Raises:
        ConfigError: Fewer than two samples or no joint, values that no arm can follow, times that
            do not increase or leap, or a segment beyond the samples.
        ShapeError: The shapes do not fit together.

    Example:
        >>> t = np.linspace(0.0, 4.0, 1001)
        >>> swing = 0.2 * (1 - np.cos(np.pi * t / 2))[:, None] * np.ones(7)
        >>> motion = limo.Motion.from_positions(t, swing)
        >>> limo.Trajectory(t, swing, motion.velocity, motion.acceleration, robot="iiwa14")
    """

    robot: str = ""  # name of the robot it was planned for
    segments: tuple[Segment, ...] = ()
    source: str = ""  # file it was read from, for messages

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self) < 2 or self.n < 1:  # noqa: PLR2004  # samples that make a motion
            raise ConfigError(
                f"holds {len(self)} samples of {self.n} joints, expected 2 or more of 1 or more"
            )
        for quantity in _QUANTITIES:
            _check_values(getattr(self, quantity), quantity)
        _check_times(self.time)
        for segment in self.segments:
            if not 0 <= segment.start < segment.stop <= len(self):
                raise ConfigError(
                    f"segment {segment.kind!r} spans samples {segment.start} to {segment.stop}, "
                    f"expected a stretch of 0 to {len(self)}"
                )

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def headline(self) -> str:
        """Say how long it is, and for which robot."""
        return super().headline() + (f", for {self.robot}" if self.robot else "")

    def figures(self) -> Mapping[str, Sequence[object]]:
        """Return the range and the peaks of each joint."""
        peaks = self.peaks()
        return {
            "joint": range(1, self.n + 1),
            "from [rad]": self.position.min(axis=0).tolist(),
            "to [rad]": self.position.max(axis=0).tolist(),
            "peak velocity [rad/s]": peaks.velocity.tolist(),
            "peak acceleration [rad/s²]": peaks.acceleration.tolist(),
        }

    def check_robot(self, n: int, name: str) -> None:
        """Check that a robot of n joints and this name can follow.

        Args:
            n: Number of joints of the robot.
            name: Of the robot.

        Raises:
            ConfigError: It was planned for another one.
        """
        if self.robot and not same_robot(self.robot, name):
            raise ConfigError(
                f"the trajectory was planned for {self.robot}, but the robot is {name}; plan again "
                "for that",
                path=self.source or None,
            )
        if self.n != n:
            raise ConfigError(
                f"the trajectory moves {self.n} joints, but {name} has {n}",
                path=self.source or None,
            )

    def first(self, duration: float) -> Trajectory:
        """Return the beginning of the trajectory.

        Args:
            duration: How much of it [s]; all of it where it is no longer.

        Raises:
            ConfigError: The duration holds fewer than two samples.
        """
        stop = int((self.time <= self.time[0] + duration).sum())
        if stop < 2:  # noqa: PLR2004  # samples that make a motion
            raise ConfigError(f"{duration:g} s is shorter than one sample of the trajectory")
        return replace(
            self,
            time=self.time[:stop],
            position=self.position[:stop],
            velocity=self.velocity[:stop],
            acceleration=self.acceleration[:stop],
            temperature=None if self.temperature is None else self.temperature[:stop],
            segments=tuple(
                replace(s, stop=min(s.stop, stop)) for s in self.segments if s.start < stop
            ),
        )

    def resample(self, period: float) -> Motion:
        """Evaluate the trajectory every `period` seconds, its last sample included.

        Args:
            period: Sample period [s].

        Returns:
            The motion, starting at time 0.

        Raises:
            ConfigError: The period is not above 0.
        """
        if not 0 < period < np.inf:
            raise ConfigError(f"a sample period of {period:g} s, expected above 0 and finite")
        count = int(np.ceil(self.duration / period - 1e-9)) + 1
        return self.evaluate(np.minimum(np.arange(count) * period, self.duration))

    def evaluate(self, time: FloatArray) -> Motion:
        """Evaluate the trajectory at any times.

        Args:
            time: After its start, (T,) [s], in order and within its duration.

        Returns:
            The motion at those times.

        Raises:
            PathError: A time is outside of the trajectory.
            ShapeError: The times are not (T,).
        """
        time = as_numbers("time", time)
        if time.ndim != 1:
            raise ShapeError("time", time.shape, "(T,)")
        t = time + self.time[0]
        first, last = (t.min(), t.max()) if t.size else self.time[[0, -1]]
        if not (first >= self.time[0] - 1e-9 and last <= self.time[-1] + 1e-9):
            raise PathError(
                f"time {time.min():.6g} to {time.max():.6g} s is outside the trajectory "
                f"(0 to {self.duration:.6g} s)"
            )
        values = [np.empty((t.size, self.n)) for _ in _QUANTITIES]
        for start in range(0, t.size, _BLOCK):
            block = slice(start, start + _BLOCK)
            left = np.clip(np.searchsorted(self.time, t[block], side="right") - 1, 0, len(self) - 2)
            h, c = self._quintics(left)
            u = (t[block] - self.time[left])[:, None] / h
            for order, quantity in enumerate(values):
                quantity[block] = _polynomial(c, u, order) / h**order
        for quantity in values:
            quantity.flags.writeable = False
        return Motion(time, *values)

    def peaks(self, rows: slice = slice(None)) -> Peaks:
        """Return the largest velocity, acceleration and jerk anywhere from one sample to the next.

        The quintic's jerk is a parabola: its largest value is known, and so are its roots, where
        the acceleration is largest; the velocity is taken at the samples and eight points between.

        Args:
            rows: Samples to look between, for example those of a segment; all by default.

        Returns:
            Of each joint, (n,) [rad/s, rad/s^2, rad/s^3].
        """
        start, stop, _ = rows.indices(len(self))
        largest = np.zeros((3, self.n))
        for first in range(start, stop - 1, _BLOCK):
            h, c = self._quintics(np.arange(first, min(first + _BLOCK, stop - 1)))
            for u in np.linspace(0.0, 1.0, 9):
                np.maximum(largest[0], np.abs(_polynomial(c, u, 1) / h).max(axis=0), out=largest[0])
            vertex, roots = _extremes(60 * c[5], 24 * c[4], 6 * c[3])
            for order, points in ((3, (0.0, 1.0, vertex)), (2, (0.0, 1.0, *roots))):
                for u in points:
                    value = np.abs(_polynomial(c, u, order) / h**order).max(axis=0)
                    np.maximum(largest[order - 1], value, out=largest[order - 1])
        return Peaks(*largest)

    def _quintics(self, left: NDArray[np.intp]) -> tuple[FloatArray, list[FloatArray]]:
        """Return the length h, (B, 1) [s], and the coefficients in u = t / h after rows `left`."""
        h = (self.time[left + 1] - self.time[left])[:, None]
        p0, p1 = self.position[left], self.position[left + 1]
        v0, v1 = self.velocity[left] * h, self.velocity[left + 1] * h
        a0, a1 = self.acceleration[left] * h**2 / 2, self.acceleration[left + 1] * h**2 / 2
        d = p1 - p0 - v0 - a0
        e = v1 - v0 - 2 * a0
        f = a1 - a0
        return h, [p0, v0, a0, 10 * d - 4 * e + f, -15 * d + 7 * e - 2 * f, 6 * d - 3 * e + f]

    def save(self, path: Path | str) -> None:
        """Write Parquet: columns time, position_j, velocity_j, acceleration_j; 1-based joints.

        Args:
            path: To be written; its ending is .parquet, .pq or none.

        Raises:
            ConfigError: It cannot be written, or its ending is that of another format.
        """
        import pyarrow as pa
        import pyarrow.parquet as pq

        from limo_driver.runtime.outputs import require_parquet, whole

        require_parquet(path)

        columns = {"time": self.time}
        for quantity in _QUANTITIES:
            values = getattr(self, quantity)
            columns |= {f"{quantity}_{j + 1}": values[:, j] for j in range(self.n)}
        header = {
            written_by.KEY: written_by.installed(),
            "robot": self.robot,
            "segments": [[s.kind, s.start, s.stop] for s in self.segments],
        }
        table = pa.table(columns).replace_schema_metadata({_METADATA_KEY: json.dumps(header)})
        with whole(path) as draft:
            pq.write_table(
                table, draft, use_dictionary=False, use_byte_stream_split=True, compression="zstd"
            )

    @classmethod
    def load(cls, path: Path | str) -> Trajectory:
        """Read a trajectory.

        Args:
            path: Parquet, as `save` writes it.

        Raises:
            ConfigError: The file is missing, is no Parquet, lacks a column, has a column or header
                of another kind, or holds what a trajectory may not.
        """
        from limo_driver.recordings.files.parquet import DAMAGE, whole_table

        check_file(Path(path), ConfigError)
        try:
            table = whole_table(Path(path), ConfigError)
        except FileNotFoundError:
            raise ConfigError("cannot be read as a trajectory: no such file", path=path) from None
        except DAMAGE as error:
            raise ConfigError(f"cannot be read as a trajectory: {error}", path=path) from None
        header, writer = (table.schema.metadata or {}).get(_METADATA_KEY, b"{}"), None
        try:
            robot, segments, writer = _parse_header(header)
            return cls(**_arrays(table), robot=robot, segments=segments, source=str(path))
        except ConfigError as error:
            advice = written_by.advice_to_update(writer)
            raise ConfigError(f"{error}{advice}", path=path) from None


class Planned(Protocol):
    """A planned trajectory, and how the plan was made."""

    @property
    def trajectory(self) -> Trajectory:
        """The motion."""
        ...


def _check_values(values: FloatArray, quantity: str) -> None:
    usable = np.abs(values) <= LARGEST  # a NaN is not
    if not usable.all():
        row, joint = (int(i) for i in np.argwhere(~usable)[0])
        raise ConfigError(
            f"{quantity}_{joint + 1} is {values[row, joint]:g} in row {row}, expected a number "
            f"within {LARGEST:g}"
        )


def _check_times(time: FloatArray) -> None:
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise ConfigError(f"time is {time[row]:g} in row {row}, expected a number")
    steps = np.diff(time)
    bad = (steps <= 0) | (steps > LONGEST_STEP)
    if bad.any():
        row = int(bad.argmax())
        raise ConfigError(
            f"time goes from {time[row]:.9g} to {time[row + 1]:.9g} s in row {row + 1}, expected "
            f"a step above 0 and up to {LONGEST_STEP:g} s"
        )
    if time[-1] - time[0] > LONGEST:
        raise ConfigError(f"lasts {time[-1] - time[0]:.6g} s, expected up to {LONGEST:g} s")


def _parse_header(text: bytes) -> tuple[str, tuple[Segment, ...], object]:
    """Return robot and segments of a file's header, and the version of limo that wrote it."""
    try:
        header: Any = json.loads(text)
        robot, listed = header.get("robot", ""), header.get("segments", [])
        segments = tuple(Segment(kind, start, stop) for kind, start, stop in listed)
    except (ValueError, TypeError, AttributeError, RecursionError):
        header, robot, segments = None, None, ()
    kinds = [(str, robot), *((str, s.kind) for s in segments)]
    kinds += [(int, row) for s in segments for row in (s.start, s.stop)]
    if any(type(value) is not kind for kind, value in kinds):
        raise ConfigError(
            f"its header {_METADATA_KEY.decode()} cannot be read; expected JSON with a robot's "
            "name and segments of kind, first row and row after the last"
        )
    return str(robot), segments, written_by.writer_of(header)


def _arrays(table: pa.Table) -> dict[str, FloatArray]:
    """Return time, position, velocity and acceleration of a table."""
    n = max(1, sum(name.startswith("position_") for name in table.column_names))
    expected = ["time", *_columns(n)]
    if missing := [name for name in expected if name not in table.column_names]:
        raise ConfigError(f"is no trajectory: it lacks {', '.join(missing)}")
    columns = {name: _numbers(table, name) for name in expected}
    return {"time": columns["time"]} | {
        quantity: np.stack([columns[f"{quantity}_{j + 1}"] for j in range(n)], axis=1)
        for quantity in _QUANTITIES
    }


def _numbers(table: pa.Table, name: str) -> FloatArray:
    """Return one column; empty cells are NaN."""
    import pyarrow as pa

    if table.column_names.count(name) > 1:
        raise ConfigError(f"has more than one column {name}")
    column = table[name]
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise ConfigError(f"column {name} holds {column.type}, expected numbers")
    return column.cast(pa.float64(), safe=False).to_numpy()


def _columns(n: int) -> Iterator[str]:
    for quantity in _QUANTITIES:
        yield from (f"{quantity}_{j + 1}" for j in range(n))


def _polynomial(c: list[FloatArray], u: FloatArray | float, order: int) -> FloatArray:
    """Evaluate the derivative of `order` of the polynomial with coefficients `c`, lowest first."""
    degree = len(c) - 1
    value = c[degree] * float(perm(degree, order))
    for k in range(degree - 1, order - 1, -1):
        value = value * u + c[k] * float(perm(k, order))
    return value


def _extremes(
    a: FloatArray, b: FloatArray, c: FloatArray
) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """Return vertex and roots of a u^2 + b u + c, moved into [0, 1]; 0 where there is none."""
    with np.errstate(all="ignore"):
        q = -0.5 * (b + np.copysign(np.sqrt(b**2 - 4 * a * c), b))  # no cancellation
        found = (-b / (2 * a), q / a, c / q)
    vertex, first, second = (np.clip(np.nan_to_num(u), 0.0, 1.0) for u in found)
    return vertex, (first, second)
