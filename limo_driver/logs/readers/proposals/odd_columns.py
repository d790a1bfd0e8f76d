"""Positions in two units: columns that may be in radians beside degrees, and rows that go on so."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.logs.readers.columns.units import UNITS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

_NARROW: Final = 0.05  # of the usual span, below which a joint hardly moves beside the others
_ALIKE: Final = (0.2, 5.0)  # spans beside the usual one, of joints that move like the others
_JUMP: Final = 0.05  # of the logarithm of 57.3, by which a joint may move within a row
_LEAP: Final = 3.0  # times the longest of usual steps, that another unit makes
_QUANTILES: Final = (0.01, 0.99)


def maybe_in_radians(
    position: FloatArray, turning: NDArray[np.bool_], fits: NDArray[np.bool_]
) -> tuple[int, ...]:
    """Return joints that hardly move in degrees, and move like the others in radians (0-based).

    A joint that turns a tool about its own axis feels no gravity: 2 may be degrees or radians.

    Args:
        position: All in degrees, (T, n).
        turning: Joints that turn, (n,).
        fits: Whether the values of each joint are within its limits in radians, (n,).
    """
    low, high = np.nanquantile(position, _QUANTILES, axis=0)
    span = high - low
    asked = list[int]()
    for j in np.flatnonzero(turning & fits).tolist():
        others = turning & (np.arange(span.size) != j)
        usual = float(np.median(span[others])) if others.any() else 0.0
        in_degrees, in_radians = float(span[j]), math.degrees(float(span[j]))
        if in_degrees < _NARROW * usual and _ALIKE[0] * usual < in_radians < _ALIKE[1] * usual:
            asked.append(j)
    return tuple(asked)


def other_unit_from(position: FloatArray) -> int | None:
    """Return the row from which positions (T, n) go on in degrees or in radians, if they do.

    There, all joints that are away from zero are multiplied or divided by 57.3 at once. Of values
    that jump no farther than they often do, as noise about zero, no ratio says anything.
    """
    steps = np.abs(np.diff(position, axis=0))
    if not len(steps):
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.abs(np.log(np.abs(position[1:] / position[:-1])))
    jumps = np.abs(ratio - math.log(1 / UNITS["position"]["deg"])) < _JUMP
    jumps &= steps > _LEAP * np.nanquantile(steps, 0.99, axis=0)
    rows = np.flatnonzero(jumps.sum(axis=1) > position.shape[1] / 2)
    return int(rows[0]) + 1 if rows.size else None
