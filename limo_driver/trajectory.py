"""Trajectory: joint motion that is commanded, and its Parquet file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.errors import ConfigError, PathError
from limo_driver.types import FloatArray, Motion

if TYPE_CHECKING:
    from collections.abc import Iterator

_METADATA_KEY = b"limo.trajectory"
_QUANTITIES = ("position", "velocity", "acceleration")


@dataclass(frozen=True)
class Segment:
    """A stretch of a trajectory: rows `start` to `stop` (exclusive)."""

    kind: str  # for example reaching, exploring
    start: int
    stop: int


@dataclass(frozen=True)
class Trajectory(Motion):
    """Commanded joint motion; between samples it is the quintic through both neighbours.

    The quintic takes position, velocity and acceleration of the two samples, so the motion is
    twice continuously differentiable at any control rate.
    """

    robot: str = ""  # name of the robot it was planned for
    segments: tuple[Segment, ...] = ()

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.time[-1] - self.time[0])

    def resample(self, period: float) -> Motion:
        """Evaluate the trajectory every `period` seconds, its last sample included.

        Args:
            period: Sample period [s].

        Returns:
            The motion, starting at time 0.
        """
        count = int(np.ceil(self.duration / period - 1e-9)) + 1
        return self.evaluate(np.minimum(np.arange(count) * period, self.duration))

    def evaluate(self, time: FloatArray) -> Motion:
        """Evaluate the trajectory at `time` [s] after its start; (T,), within its duration."""
        t = time + self.time[0]
        if t.size and (t[0] < self.time[0] - 1e-9 or t[-1] > self.time[-1] + 1e-9):
            raise PathError(
                f"time {time[0]:.6g} to {time[-1]:.6g} s is outside the trajectory "
                f"(0 to {self.duration:.6g} s)"
            )
        left = np.clip(np.searchsorted(self.time, t, side="right") - 1, 0, len(self) - 2)
        h = (self.time[left + 1] - self.time[left])[:, None]
        u = (t - self.time[left])[:, None] / h
        p0, p1 = self.position[left], self.position[left + 1]
        v0, v1 = self.velocity[left] * h, self.velocity[left + 1] * h
        a0, a1 = self.acceleration[left] * h**2 / 2, self.acceleration[left + 1] * h**2 / 2
        d = p1 - p0 - v0 - a0
        e = v1 - v0 - 2 * a0
        f = a1 - a0
        c3, c4, c5 = 10 * d - 4 * e + f, -15 * d + 7 * e - 2 * f, 6 * d - 3 * e + f
        return Motion(
            time=time,
            position=p0 + u * (v0 + u * (a0 + u * (c3 + u * (c4 + u * c5)))),
            velocity=(v0 + u * (2 * a0 + u * (3 * c3 + u * (4 * c4 + u * 5 * c5)))) / h,
            acceleration=(2 * a0 + u * (6 * c3 + u * (12 * c4 + u * 20 * c5))) / h**2,
        )

    def save(self, path: Path | str) -> None:
        """Write Parquet: columns time, position_j, velocity_j, acceleration_j; 1-based joints."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {"time": self.time}
        for quantity in _QUANTITIES:
            values = getattr(self, quantity)
            columns |= {f"{quantity}_{j + 1}": values[:, j] for j in range(self.n)}
        header = {
            "robot": self.robot,
            "segments": [[s.kind, s.start, s.stop] for s in self.segments],
        }
        table = pa.table(columns).replace_schema_metadata({_METADATA_KEY: json.dumps(header)})
        pq.write_table(table, path, use_dictionary=False)

    @classmethod
    def load(cls, path: Path | str) -> Trajectory:
        """Read a trajectory.

        Raises:
            ConfigError: The file is missing, is no Parquet, or lacks a column.
        """
        import pyarrow.parquet as pq
        from pyarrow import ArrowException

        try:
            table = pq.read_table(Path(path))
        except (OSError, ArrowException) as error:
            raise ConfigError(f"cannot be read as a trajectory: {error}", path=path) from None
        n = sum(name.startswith("position_") for name in table.column_names)
        expected = ["time", *_columns(n)]
        if missing := [name for name in expected if name not in table.column_names]:
            raise ConfigError(f"is no trajectory: it lacks {', '.join(missing)}", path=path)
        header = json.loads((table.schema.metadata or {}).get(_METADATA_KEY, b"{}"))
        arrays = {
            quantity: np.stack([table[f"{quantity}_{j + 1}"].to_numpy() for j in range(n)], axis=1)
            for quantity in _QUANTITIES
        }
        return cls(
            time=table["time"].to_numpy(),
            **arrays,
            robot=header.get("robot", ""),
            segments=tuple(Segment(*segment) for segment in header.get("segments", ())),
        )


def _columns(n: int) -> Iterator[str]:
    for quantity in _QUANTITIES:
        yield from (f"{quantity}_{j + 1}" for j in range(n))
