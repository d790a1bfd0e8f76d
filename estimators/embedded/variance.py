"""The variance of joint physics in terms that are zero most of the time, for C.

The leverage x Rᵀ R xᵀ costs one product for each entry of R. Stops that are narrower than the way
since the joint turned have all come to the same end, ±1, so that of two of them the difference is
exactly zero. In the differences z of stops that are next in width, x = E z, the same leverage is
|L z|² with Lᵀ L = (R E)ᵀ (R E), and a column of L counts only where its term is not zero. L is
lower triangular: the terms that are zero most often, of the narrowest stops, have the longest
columns, and stand first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.joint_physics.column_scan import FRICTION_HARMONICS, STATES, WIDTHS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from estimators.joint_physics.columns import JointColumns
    from limo_driver.types import FloatArray

LANES: Final = 16  # floats that fill the widest vectors
_GROUP: Final = 4  # columns of L, taken at a time


@dataclass(frozen=True)
class VarianceTerms:
    """Of one joint with p columns that count."""

    kept: NDArray[np.int64]  # (p,), the columns, in the order of their terms
    less: NDArray[np.int64]  # (p,), the column taken off each; their number K where none is
    root: NDArray[np.float32]  # L by groups of four columns, each from the group's first row on


def terms_of(columns: JointColumns, root: FloatArray) -> VarianceTerms:
    """Return the terms of a joint with the root R of its weights' covariance, (K, K)."""
    counts = np.asarray(root.any(axis=0))
    stops = _stops(columns).T.ravel()  # the narrowest of every family first
    rest = np.setdiff1d(np.arange(columns.count), stops)
    kept = np.concatenate([stops, rest])
    kept = kept[counts[kept]]
    less = np.full(columns.count, columns.count)
    for family in _stops(columns):
        own = family[counts[family]]
        less[own[:-1]] = own[1:]
    change = np.eye(kept.size)  # z of x
    place = np.full(columns.count + 1, -1)
    place[kept] = np.arange(kept.size)
    taken = place[less[kept]]
    change[taken >= 0, taken[taken >= 0]] = -1.0
    of_terms = root[:, kept] @ np.linalg.inv(change)
    return VarianceTerms(kept, less[kept], _by_columns(_lower(of_terms)))


def _stops(columns: JointColumns) -> NDArray[np.int64]:
    """Return the columns of the stops, (families, stops), the narrowest first."""
    waves = columns.of_family("place_friction").start
    starts = [columns.of_family(name).start for name in ("friction", "load")]
    starts += [waves + k * (STATES + 1) for k in range(2 * FRICTION_HARMONICS)]
    return np.array(starts)[:, None] + np.arange(WIDTHS.size)


def _lower(root: FloatArray) -> FloatArray:
    """Return the lower triangular L with Lᵀ L = Rᵀ R."""
    _, upper = np.linalg.qr(root[:, ::-1])
    return upper[::-1, ::-1]


def _by_columns(lower: FloatArray) -> NDArray[np.float32]:
    """Return L in the order in which the code reads it, with zeros up to whole vectors."""
    size = len(lower)
    padded = np.zeros((size + LANES, _padded(size, _GROUP)), np.float32)
    padded[:size, :size] = lower
    groups = [
        padded[k : k + _padded(size - k, LANES), k : k + _GROUP].T.ravel()
        for k in range(0, size, _GROUP)
    ]
    return np.concatenate(groups)


def _padded(size: int, to: int) -> int:
    return -(-size // to) * to
