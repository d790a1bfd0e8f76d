"""Gaps: steps of time over which motion cannot be interpolated."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

LONGEST_STEP = 0.05  # [s]; motion within the bandwidth of an arm can be interpolated over less
LONGEST_STEP_PERIODS = 3.0  # [sample periods], for slow recordings


def contiguous(time: FloatArray) -> tuple[slice, ...]:
    """Split increasing times (T,) [s] at the gaps."""
    if time.size == 0:
        return ()
    steps = np.diff(time)
    ends = np.flatnonzero(steps > longest_step(steps)) + 1
    bounds = [0, *ends.tolist(), time.size]
    return tuple(slice(a, b) for a, b in pairwise(bounds))


def longest_step(steps: FloatArray) -> float:
    """Return the longest step that is no gap [s], by the steps of time (T - 1,) [s]."""
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else LONGEST_STEP
    return max(LONGEST_STEP, LONGEST_STEP_PERIODS * period)
