"""Unwrapping: positions of a joint that count on at the other end of their encoder's range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_TURN = 2 * np.pi
_OF_SPAN = 0.9  # of all that is recorded, that a wrap crosses at least
_OF_WRAP = 0.1  # of a wrap, that the joint moves in a sample beside it at most
_LEAST = 0.5  # [rad]; a smaller leap is a fault
_ALIKE = 0.01  # of a wrap, by which wraps of one joint differ
_BESIDE = 3  # samples before and after, whose median step is the joint's own motion
_FEWEST = 2  # wraps by another angle than a turn; one alone could be a slip


@dataclass(frozen=True)
class Unwrapped:
    """Positions of one joint without wraps."""

    position: FloatArray  # (T,) [rad]
    wraps: int
    period: float  # [rad] between the ends


def unwrapped(position: FloatArray) -> Unwrapped | None:
    """Take the wraps out of the positions of a joint; None where there is none.

    A wrap is known by what it does, not by its size alone, since an encoder may sit before a gear:
    the position leaps from one end of all that was recorded to the other, while the joint moves on
    against the leap, and every leap is of the same size. Where that size is a turn, the joint may
    also hover at the ends.

    Args:
        position: (T,) [rad], of samples without gaps; NaN where there is none.
    """
    steps = np.diff(position)
    sizes = np.abs(np.nan_to_num(steps))
    largest = float(sizes.max(initial=0.0))
    if largest < _LEAST or largest < _OF_SPAN * (np.nanmax(position) - np.nanmin(position)):
        return None
    leaps = np.flatnonzero(sizes > (1 - 2 * _OF_WRAP) * largest)
    before = np.array([_usual(steps[max(at - _BESIDE, 0) : at]) for at in leaps])
    after = np.array([_usual(steps[at + 1 : at + 1 + _BESIDE]) for at in leaps])
    if not (np.maximum(np.abs(before), np.abs(after)) < _OF_WRAP * largest).all():
        return None
    sizes = np.abs(steps[leaps] - (before + after) / 2)
    period = float(np.median(sizes))
    if (np.abs(sizes - period) > _ALIKE * period).any():
        return None
    if abs(period - _TURN) < _ALIKE * _TURN:
        period = _TURN
    elif (
        leaps.size < _FEWEST or (np.maximum(before * steps[leaps], after * steps[leaps]) >= 0).any()
    ):
        return None
    count = np.zeros(position.size)
    count[leaps + 1] = -np.sign(steps[leaps])
    return Unwrapped(position + period * np.cumsum(count), leaps.size, period)


def _usual(steps: FloatArray) -> float:
    """Return the median of some steps; 0 where there is none, as at the ends of a recording."""
    known = steps[np.isfinite(steps)]
    return float(np.median(known)) if known.size else 0.0
