"""Recording: measured joint motion and torque in order of time, checked as it is read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from limo_driver.types import FloatArray, Motion

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class LeftOut:
    """Rows of a file that cannot be used."""

    reason: str
    rows: tuple[int, ...]  # 0-based rows of the file


@dataclass(frozen=True)
class Recording:
    """T usable samples of n joints.

    Velocity is kept as the robot gave it; `motion` computes velocity and acceleration from the
    positions, with a stated bandwidth.
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

    @classmethod
    def load(cls, path: Path | str) -> Recording:
        """Read Parquet, CSV or limo's own log."""
        raise NotImplementedError

    def motion(self, bandwidth: float) -> Motion:
        """Differentiate without phase."""
        raise NotImplementedError

    def filtered_torque(self, bandwidth: float) -> FloatArray:
        """Filter the torque as `motion` filters the positions."""
        raise NotImplementedError
