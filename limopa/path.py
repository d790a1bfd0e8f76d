"""Paths: joint position as a smooth function of one parameter s, with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from limo_driver.types import FloatArray, readonly


class Path(Protocol):
    """Joint position q(s) for 0 <= s <= length."""

    @property
    def length(self) -> float:
        """Largest value of the parameter."""
        ...

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` (0 is the position) with respect to s, (T, n)."""
        ...

    def peaks(self) -> FloatArray:
        """Return bounds of |q'|, |q''| and |q'''| of each joint over the whole path, (3, n)."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight path in joint space, q(s) = start + s (end - start), of length 1."""

    start: FloatArray  # (n,) [rad]
    end: FloatArray  # (n,) [rad]

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", readonly(self.start))
        object.__setattr__(self, "end", readonly(self.end))

    @property
    def length(self) -> float:
        """Largest value of the parameter."""
        return 1.0

    def derivative(self, s: FloatArray, order: int) -> FloatArray:
        """Return the derivative of `order` with respect to s, (T, n) [rad]."""
        step = self.end - self.start
        if order == 0:
            return self.start + s[:, None] * step
        return np.tile(step if order == 1 else 0.0 * step, (len(s), 1))

    def peaks(self) -> FloatArray:
        """Return |q'|, |q''| and |q'''| of each joint, (3, n)."""
        step = np.abs(self.end - self.start)
        return np.stack([step, 0.0 * step, 0.0 * step])
