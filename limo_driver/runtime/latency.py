"""Histogram of durations, of constant size."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LOWEST: Final = 1e-6  # [s]
_PER_DECADE: Final = 50  # bins; a percentile is good to 5 %
_BINS: Final = 8 * _PER_DECADE  # up to 100 s


class LatencyHistogram:
    """Counts durations in bins of equal ratio from 1 µs to 100 s."""

    def __init__(self) -> None:
        self._counts = [0] * _BINS
        self.longest = 0.0  # [s]

    def add(self, duration: float) -> None:
        """Count a duration [s]; what is below 1 µs counts as that."""
        bin_ = int(_PER_DECADE * math.log10(duration / _LOWEST)) if duration > _LOWEST else 0
        self._counts[bin_ if bin_ < _BINS else -1] += 1
        self.longest = max(self.longest, duration)

    @property
    def count(self) -> int:
        """Durations counted."""
        return sum(self._counts)

    @property
    def edges(self) -> NDArray[np.float64]:
        """Upper edges of the bins [s]."""
        return _LOWEST * 10.0 ** (np.arange(1, _BINS + 1) / _PER_DECADE)

    def percentile(self, percent: float) -> float:
        """Return the upper edge of the bin that holds a percentile [s]; NaN if there is none."""
        if not self.count:
            return float("nan")
        reached = np.cumsum(self._counts) >= percent / 100.0 * self.count
        return min(float(self.edges[int(np.argmax(reached))]), self.longest)

    def take(self) -> LatencyHistogram:
        """Return what was counted, and begin anew."""
        taken = LatencyHistogram()
        taken._counts, self._counts = self._counts, [0] * _BINS
        taken.longest, self.longest = self.longest, 0.0
        return taken

    def summary(self) -> str:
        """Return percentiles as text [ms]."""
        if not self.count:
            return "none counted"
        return (
            f"p50 {1e3 * self.percentile(50):.3f}, p99 {1e3 * self.percentile(99):.3f}, "
            f"p99.9 {1e3 * self.percentile(99.9):.3f}, longest {1e3 * self.longest:.3f} ms"
        )

    def as_json(self) -> dict[str, Any]:
        """Return percentiles [s] and the counts per decade, as JSON values."""
        if not self.count:
            return {"count": 0}
        return {
            "count": self.count,
            **{f"p{p:g}".replace(".", "_"): self.percentile(p) for p in (50, 99, 99.9)},
            "longest": self.longest,
            "counts": list(self._counts),
        }
