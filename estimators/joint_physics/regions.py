"""Regions of the poses of recordings, each left out in turn: other motion than the rest.

Blocks of time say how a fit does on motion like the rest of it. Where a motion repeats itself,
leaving a block out leaves out nothing: its poses are in the other blocks, too. So poses are halved
at the median of their first principal component, and each half again along its own, until there
are REGIONS parts. However often the arm came back to a part, a fit without it was never there.

Source: Roberts et al., "Cross-validation strategies for data with temporal, spatial, hierarchical,
or phylogenetic structure", Ecography 2017 (blocks in the space of the predictors); Bentley,
"Multidimensional binary search trees", Communications of the ACM 1975 (the halves).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_LEVELS: Final = 3  # of halving
REGIONS: Final = 2**_LEVELS
_POSES: Final = 20_000  # that the halves are made of
_AS_MUCH: Final = 1e-6  # relative difference of variances that does not tell directions apart
_ALIKE: Final = 1e-9  # [rad]; poses closer than this may differ by rounding only


@dataclass(frozen=True)
class Regions:
    """A tree of halves; the two of node k are the nodes 2 k + 1 and 2 k + 2."""

    axes: FloatArray  # (REGIONS - 1, n), first principal component of a node's poses
    middles: FloatArray  # (REGIONS - 1,) [rad], between the halves along it

    @classmethod
    def of(cls, recordings: Sequence[Recording]) -> Regions:
        """Halve the poses of recordings."""
        every = -(-sum(len(recording) for recording in recordings) // _POSES)
        poses = np.concatenate([recording.position[::every] for recording in recordings])
        found = cls(np.zeros((REGIONS - 1, poses.shape[1])), np.zeros(REGIONS - 1))
        parts = [poses]
        for node in range(REGIONS - 1):
            own = parts[node]
            if not len(own):  # the poses above are all alike
                parts += [own, own]
                continue
            found.axes[node] = _first_component(own)
            along = own @ found.axes[node]
            found.middles[node] = _middle(along)
            parts += [own[along <= found.middles[node]], own[along > found.middles[node]]]
        return found

    def at(self, position: FloatArray) -> NDArray[np.int64]:
        """Return in which region poses (T, n) [rad] are, (T,)."""
        node = np.zeros(len(position), dtype=np.int64)
        for _ in range(_LEVELS):
            along = np.einsum("ti,ti->t", position, self.axes[node])
            node = 2 * node + 1 + (along > self.middles[node])
        return node - self.middles.size


def _first_component(poses: FloatArray) -> FloatArray:
    """Return the direction (n,) in which poses (T, n) differ most.

    Where they differ as much in several, any mixture of these would do, and its sign: the one
    nearest to the first joint that has a part in them is taken.
    """
    centred = poses - poses.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred)
    most = vectors[:, values >= (1.0 - _AS_MUCH) * values[-1]]
    part = np.sum(most**2, axis=1)
    joint = int(np.argmax(part >= (1.0 - _AS_MUCH) * part.max()))
    axis = most @ most[joint]
    return axis / np.linalg.norm(axis)


def _middle(along: FloatArray) -> float:
    """Return a place near the median of values (T,) [rad] that none of them is at.

    At the median itself lie poses that rounding would put on the one side or the other.
    """
    values = np.sort(along)
    apart = np.flatnonzero(np.diff(values) > _ALIKE)
    if not apart.size:
        return float(values[-1])  # all are alike, and stay together
    k = int(apart[np.abs(apart + 1 - values.size / 2).argmin()])
    return float(values[k] + values[k + 1]) / 2
