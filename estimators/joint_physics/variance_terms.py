"""The variance of joint physics in terms that are zero most of the time.

The leverage x Rᵀ R xᵀ costs one product for each entry of R. States of friction that have all come
to the same end, ±1, are equal: stops narrower than half the way since the joint turned, and
directions that are steep beside its speed. In the differences z of states that come to their ends
one after the other, x = E z, the same leverage is |L z|² with Lᵀ L = (R E)ᵀ (R E), and a column of
L counts only where its term is not zero. L is lower triangular: the terms that are zero most often
have the longest columns, and stand first. One state goes with all families of friction, so that
their terms are zero together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.joint_physics.column_scan import SPEEDS, STATES, WIDTHS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

LANES: Final = 16  # floats that fill the widest vectors
GROUP: Final = 6  # columns of L, taken at a time: as many as there are families of friction
NOTHING: Final = 2.0**-24  # of two states, between which single precision cannot tell

_STOPS: Final = np.arange(WIDTHS.size)
_SHARP: Final = np.arange(WIDTHS.size + SPEEDS.size, STATES)
_SLOW, _FAST = np.split(np.arange(WIDTHS.size, WIDTHS.size + SPEEDS.size), [2])
# A filtered step takes the sharp signs to where directions of 0.02 rad/s are.
_DIRECTIONS: Final = np.concatenate([_SLOW, _SHARP, _FAST])
_WIDE: Final = 4  # stops that hardly ever come to their ends
ORDER: Final = np.concatenate([_STOPS[:-_WIDE], _DIRECTIONS, _STOPS[-_WIDE:], [STATES]])


def _next() -> NDArray[np.int64]:
    """Return the state that is taken off each, itself where none is, (states and dq,)."""
    found = np.arange(STATES + 1)
    for chain in (_STOPS, _DIRECTIONS):
        found[chain[:-1]] = chain[1:]
    return found


NEXT: Final = _next()


@dataclass(frozen=True)
class VarianceTerms:
    """Of one joint with p columns: those of friction, and of the others those that count."""

    kept: NDArray[np.int64]  # (p,), the columns, in the order of their terms
    less: NDArray[np.int64]  # (p,), the column taken off each; their number K where none is
    root: NDArray[np.float32]  # L by groups of columns, see `_by_columns`


def terms_of(root: FloatArray, friction: NDArray[np.int64]) -> VarianceTerms:
    """Return the terms of a joint.

    Args:
        root: R, the root of its weights' covariance, (K, K).
        friction: Columns of friction, (families, states and dq).
    """
    count, counts = root.shape[1], np.asarray(root.any(axis=0))
    of_friction = friction[:, ORDER].T.ravel()  # of every family first
    others = np.setdiff1d(np.arange(count), of_friction)
    kept = np.concatenate([of_friction, others[counts[others]]])
    less = np.full(count, count)
    taken_off = np.flatnonzero(np.arange(STATES + 1) != NEXT)
    less[friction[:, taken_off]] = friction[:, NEXT[taken_off]]
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
    """Return L in the order in which the code reads it: groups of columns, with zeros around.

    A group has whole vectors of rows, from that of its first row to the last, with the zeros before
    its first row. Of each vector the columns follow each other, so that all is read as it lies.
    """
    size = len(lower)
    above = padded(size, LANES) - size  # rows of zeros, so that the last vector is full
    filled = np.zeros((above + size, padded(size, GROUP)), np.float32)
    filled[above:, :size] = lower
    groups = [
        filled[(above + k) // LANES * LANES :, k : k + GROUP].reshape(-1, LANES, GROUP)
        for k in range(0, size, GROUP)
    ]
    return np.concatenate([group.swapaxes(1, 2).ravel() for group in groups])


def padded(size: int, to: int) -> int:
    """Return a size, filled up to a multiple."""
    return -(-size // to) * to
