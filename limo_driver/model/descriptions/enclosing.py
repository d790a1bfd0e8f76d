"""The smallest capsule that was found around the corners of a shape."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.types import FloatArray

_WIDER: Final = np.linspace(1.0, 1.6, 13)  # radii that are tried, in the least there can be
_ROUNDS: Final = 100  # of moving the centre towards the farthest corner


class Enclosing(NamedTuple):
    """All points within a radius of a segment."""

    start: FloatArray  # (3,) [m]
    end: FloatArray  # (3,) [m]
    radius: float  # [m]


def enclosing_capsule(points: FloatArray) -> Enclosing:
    """Return a capsule around points, the smallest of several axes and radii.

    A thicker capsule may be shorter, since its ends are round.

    Args:
        points: (K, 3) [m].
    """
    middle = points.mean(axis=0)
    _, _, own = np.linalg.svd(points - middle, full_matrices=False)
    best, least = None, np.inf
    for axis in (*np.eye(3), *own):
        for found in _along(points - middle, axis):
            length = float(np.linalg.norm(found.end - found.start))
            volume = np.pi * found.radius**2 * (length + 4 / 3 * found.radius)
            if volume < least:
                best, least = found, volume
    assert best is not None  # noqa: S101  # there are axes
    return Enclosing(middle + best.start, middle + best.end, best.radius)


def box_corners(size: FloatArray) -> FloatArray:
    """Return the corners of a box around the origin, (8, 3) [m].

    Args:
        size: Whole lengths of its sides, (3,) [m].
    """
    return np.array(list(product((-0.5, 0.5), repeat=3))) * size


def _along(points: FloatArray, axis: FloatArray) -> Iterator[Enclosing]:
    """Yield capsules along an axis around points, (K, 3), from the thinnest on."""
    across = np.linalg.svd(axis[None])[2][1:]  # two directions at right angles to it
    flat, along = points @ across.T, points @ axis
    centre = _centre(flat)
    distance = np.linalg.norm(flat - centre, axis=1)
    base = centre @ across
    for radius in (_WIDER * float(distance.max())).tolist():
        reach = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
        low, high = float((along + reach).min()), float((along - reach).max())
        if low > high:
            low = high = (low + high) / 2
        yield Enclosing(base + low * axis, base + high * axis, radius)


def _centre(flat: FloatArray) -> FloatArray:
    """Return the centre of a circle around points (K, 2) that is nearly the smallest.

    Source: Bădoiu and Clarkson, "Smaller core-sets for balls", SODA 2003.
    """
    centre = flat.mean(axis=0)
    for k in range(1, _ROUNDS):
        farthest = flat[int(np.linalg.norm(flat - centre, axis=1).argmax())]
        centre = centre + (farthest - centre) / (k + 1)
    return centre
