"""The variance of joint physics in terms that are zero most of the time.

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

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

LANES: Final = 16  # floats that fill the widest vectors
GROUP: Final = 4  # columns of L, taken at a time


@dataclass(frozen=True)
class VarianceTerms:
    """Of one joint with p columns that count."""

    kept: NDArray[np.int64]  # (p,), the columns, in the order of their terms
    less: NDArray[np.int64]  # (p,), the column taken off each; their number K where none is
    root: NDArray[np.float32]  # L by groups of four columns, each from the group's first row on


def terms_of(root: FloatArray, stops: NDArray[np.int64]) -> VarianceTerms:
    """Return the terms of a joint.

    Args:
        root: R, the root of its weights' covariance, (K, K).
        stops: Columns of the stops, (families, widths), the narrowest first.
    """
    count, counts = root.shape[1], np.asarray(root.any(axis=0))
    narrowest = stops.T.ravel()  # of every family first
    kept = np.concatenate([narrowest, np.setdiff1d(np.arange(count), narrowest)])
    kept = kept[counts[kept]]
    less = np.full(count, count)
    for family in stops:
        own = family[counts[family]]
        less[own[:-1]] = own[1:]
    change = np.eye(kept.size)  # z of x
    place = np.full(count + 1, -1)
    place[kept] = np.arange(kept.size)
    taken = place[less[kept]]
    change[taken >= 0, taken[taken >= 0]] = -1.0
    of_terms = root[:, kept] @ np.linalg.inv(change)
    return VarianceTerms(kept, less[kept], _by_columns(_lower(of_terms)))


def _lower(root: FloatArray) -> FloatArray:
    """Return the lower triangular L with Lᵀ L = Rᵀ R."""
    _, upper = np.linalg.qr(root[:, ::-1])
    return upper[::-1, ::-1]


def _by_columns(lower: FloatArray) -> NDArray[np.float32]:
    """Return L in the order in which the code reads it, with zeros up to whole vectors."""
    size = len(lower)
    padded = np.zeros((size + LANES, _padded(size, GROUP)), np.float32)
    padded[:size, :size] = lower
    groups = [
        padded[k : k + _padded(size - k, LANES), k : k + GROUP].T.ravel()
        for k in range(0, size, GROUP)
    ]
    return np.concatenate(groups)


def _padded(size: int, to: int) -> int:
    return -(-size // to) * to
