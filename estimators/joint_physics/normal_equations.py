"""Normal equations of each joint, summed over recordings part by part, and rows to judge them on.

A fit needs of any number of samples only Σ x xᵀ and Σ x y. They are summed over parts of two kinds,
each of which can be left out: folds, to which blocks of time are dealt in turn, longer than a pose
of LIMO lasts, and regions of the poses, to which the motion may have come back many times.

Regions of the poses of recordings, each left out in turn: other motion than the rest.

Blocks of time say how a fit does on motion like the rest of it. Where a motion repeats itself,
leaving a block out leaves out nothing: its poses are in the other blocks, too. So poses are halved
at the median of their first principal component, and each half again along its own, until there
are REGIONS parts. However often the arm came back to a part, a fit without it was never there.

Source: Roberts et al., "Cross-validation strategies for data with temporal, spatial, hierarchical,
or phylogenetic structure", Ecography 2017 (blocks in the space of the predictors); Bentley,
"Multidimensional binary search trees", Communications of the ACM 1975 (the halves).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import check_every_joint, check_recordings
from estimators.joint_physics.columns import SETTLED
from estimators.regression.evidence import NormalEquations
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from estimators.joint_physics.columns import ColumnRows, JointColumns
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, IntArray

FOLDS: Final = 5
_LONGEST: Final = 30.0  # [s] of a block
_ROWS: Final = 1024  # whose columns are held at a time
_DENSE: Final = 4  # rows summed per 1/bandwidth; filtered signals hold nothing that more would show
_JUDGED: Final = 20_000  # rows kept
_LEVELS: Final = 3  # of halving
REGIONS: Final = 2**_LEVELS
_POSES: Final = 20_000  # that the halves are made of
_AS_MUCH: Final = 1e-6  # relative difference of variances that does not tell directions apart
_ALIKE: Final = 1e-9  # [rad]; poses closer than this may differ by rounding only


@dataclass(frozen=True)
class Sums:
    """Sums over the rows of each of P parts, for n joints of K columns."""

    gram: FloatArray  # (P, n, K, K), Σ x xᵀ
    product: FloatArray  # (P, n, K), Σ x y
    energy: FloatArray  # (P, n), Σ y² [N² m²]
    count: FloatArray  # (P, n), rows

    @classmethod
    def none(cls, parts: int, columns: JointColumns) -> Sums:
        """Return the sums over no rows."""
        shape, K = (parts, columns.n), columns.count
        return cls(
            np.zeros((*shape, K, K)), np.zeros((*shape, K)), np.zeros(shape), np.zeros(shape)
        )

    def add(self, part: int, joint: int, rows: NormalEquations) -> None:
        """Add the sums over some rows of a part and a joint (0-based), in place."""
        self.gram[part, joint] += rows.gram
        self.product[part, joint] += rows.product
        self.energy[part, joint] += rows.energy
        self.count[part, joint] += rows.rows

    def equations(self, joint: int, without: int | None = None) -> NormalEquations:
        """Return the sums of one joint (0-based), all of them or without a part."""
        use = np.arange(len(self.count)) != without
        return NormalEquations(
            self.gram[use, joint].sum(axis=0),
            self.product[use, joint].sum(axis=0),
            float(self.energy[use, joint].sum()),
            float(self.count[use, joint].sum()),
        )

    def of_part(self, joint: int, part: int) -> NormalEquations:
        """Return the sums of one joint (0-based) over one part."""
        return NormalEquations(
            self.gram[part, joint],
            self.product[part, joint],
            float(self.energy[part, joint]),
            float(self.count[part, joint]),
        )

    def beyond(self, weights: FloatArray) -> Sums:
        """Return the sums of what weights (n, K) leave of the residual."""
        inner = np.einsum("pjkl,jl->pjk", self.gram, weights)
        energy = np.einsum("pjk,jk->pj", inner - 2.0 * self.product, weights)
        return replace(
            self, product=self.product - inner, energy=np.maximum(self.energy + energy, 0.0)
        )

    def each_left_out(self, joint: int) -> list[NormalEquations]:
        """Return the sums of one joint (0-based) without each part."""
        return [self.equations(joint, without=part) for part in range(len(self.count))]


@dataclass(frozen=True)
class MotionEquations:
    """Sums over the same rows, by folds of time and by regions of the poses."""

    folds: Sums
    regions: Sums
    judged: JudgedRows

    @classmethod
    def of(
        cls, simulation: Simulation, columns: JointColumns, recordings: Sequence[Recording]
    ) -> MotionEquations:
        """Sum the normal equations of the simulation's residual over recordings.

        Raises:
            RecordingError: There is none, one is of another robot or given twice, nothing moves, no
                torque was measured, or that of a joint was not, or no row is left.
        """
        check_recordings(recordings, simulation.model)
        check_every_joint(recordings)
        folds, regions = Sums.none(FOLDS, columns), Sums.none(REGIONS, columns)
        kept: list[JudgedRows] = []
        every = _share(recordings, columns)
        for rows, residual, fold, region in _chunks(simulation, columns, recordings):
            for f, r in np.unique(np.stack([fold, region]), axis=1).T:
                both = (fold == f) & (region == r)
                for j in range(columns.n):
                    own = both & rows.settled[:, j]
                    found = NormalEquations.of(rows.columns[j, own], residual[own, j])
                    folds.add(f, j, found)
                    regions.add(r, j, found)
            kept.append(JudgedRows.of(rows, residual, fold, region, every))
        _check_enough(folds.count, columns, recordings)
        return cls(folds, regions, JudgedRows.joined(kept))

    def beyond(self, weights: FloatArray) -> MotionEquations:
        """Return the same of what weights (n, K) leave of the residual."""
        left = np.einsum("jtk,jk->tj", self.judged.columns, weights)
        judged = replace(self.judged, residual=self.judged.residual - left)
        return MotionEquations(self.folds.beyond(weights), self.regions.beyond(weights), judged)

    @property
    def usual(self) -> FloatArray:
        """Mean square of the residual, (n,) [N² m²]."""
        return self.folds.energy.sum(axis=0) / self.folds.count.sum(axis=0)


@dataclass(frozen=True)
class JudgedRows:
    """Some of the rows, to judge on those of a part what the others gave."""

    columns: NDArray[np.float32]  # (n, T, K)
    residual: FloatArray  # (T, n) [N m], of the simulation
    settled: BoolArray  # (T, n); others do not count
    fold: IntArray  # (T,)
    region: IntArray  # (T,)

    @classmethod
    def of(
        cls, rows: ColumnRows, residual: FloatArray, fold: IntArray, region: IntArray, every: int
    ) -> JudgedRows:
        """Keep one row of so many."""
        x = rows.columns[:, ::every].astype(np.float32)
        return cls(x, residual[::every], rows.settled[::every], fold[::every], region[::every])

    @classmethod
    def joined(cls, parts: Sequence[JudgedRows]) -> JudgedRows:
        """Join rows of several chunks."""
        return cls(
            np.concatenate([part.columns for part in parts], axis=1),
            np.concatenate([part.residual for part in parts]),
            np.concatenate([part.settled for part in parts]),
            np.concatenate([part.fold for part in parts]),
            np.concatenate([part.region for part in parts]),
        )


def _check_enough(
    count: FloatArray, columns: JointColumns, recordings: Sequence[Recording]
) -> None:
    """Check that each joint moves in every fold, and has as many rows as weights; count (F, n).

    With fewer, priors alone decide on weights, and folds that are alike confirm each other.
    """
    # The range that each joint turns in within each fold, the largest of all recordings
    found = np.zeros((FOLDS, recordings[0].n))
    for recording in recordings:
        fold = fold_of(recording)
        for f in np.unique(fold):
            found[f] = np.maximum(found[f], np.ptp(recording.position[fold == f], axis=0))
    still = np.flatnonzero((found <= SETTLED).any(axis=0) | (count == 0).any(axis=0))
    if still.size:
        raise RecordingError(
            f"the recordings say too little of joint {still[0] + 1}: it has to turn by more than "
            f"{SETTLED:g} rad in each of {FOLDS} parts of the motion",
            path=recordings[0].source or None,
        )
    rows = count.sum(axis=0)
    j = int(rows.argmin())
    if rows[j] < columns.count:
        raise RecordingError(
            f"the recordings say too little of joint {j + 1}: {rows[j]:.0f} rows after it has "
            f"turned by {SETTLED:g} rad, expected at least {columns.count}, as many as its weights",
            path=recordings[0].source or None,
        )


def _stride(recording: Recording, columns: JointColumns) -> int:
    """Return how many samples there are to a row."""
    return max(1, int(recording.rate / (_DENSE * columns.bandwidth)))


def _share(recordings: Sequence[Recording], columns: JointColumns) -> int:
    """Return how many rows there are to one that is judged."""
    rows = sum(len(recording) // _stride(recording, columns) for recording in recordings)
    return -(-rows // _JUDGED) or 1


def _chunks(
    simulation: Simulation, columns: JointColumns, recordings: Sequence[Recording]
) -> Iterator[tuple[ColumnRows, FloatArray, IntArray, IntArray]]:
    """Give r rows, their residual torque (r, n), fold (r,) and region (r,), chunk by chunk."""
    regions = Regions.of(recordings)
    for recording in recordings:
        bandwidth, every = columns.bandwidth, _stride(recording, columns)
        motion, torque = recording.motion(bandwidth), recording.filtered_torque(bandwidth)
        inside, fold = ~recording.edges(bandwidth), fold_of(recording)
        region = regions.at(recording.position)
        for rows in recording.segments:
            bodies, memory = simulation.init(), columns.init()
            for start in range(rows.start, rows.stop, every * _ROWS):
                piece = slice(start, min(start + every * _ROWS, rows.stop))
                predicted, bodies = simulation.advance(bodies, motion[piece])
                found, memory = columns.advance(memory, motion[piece], predicted, every)
                use = inside[piece][::every]
                residual = (torque[piece] - predicted)[::every]
                own_fold, own_region = fold[piece][::every][use], region[piece][::every][use]
                yield found.of(use), residual[use], own_fold, own_region


def fold_of(recording: Recording) -> IntArray:
    """Return which fold each sample of a recording is in, (T,)."""
    time = recording.time - recording.time[0]
    block = min(_LONGEST, recording.duration / FOLDS)
    return np.floor(time / max(block, 1e-9)).astype(np.int64) % FOLDS


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
            # The direction (n,) in which poses (T, n) differ most
            centred = own - own.mean(axis=0)
            values, vectors = np.linalg.eigh(centred.T @ centred)
            most = vectors[:, values >= (1.0 - _AS_MUCH) * values[-1]]
            part = np.sum(most**2, axis=1)
            joint = int(np.argmax(part >= (1.0 - _AS_MUCH) * part.max()))
            axis = most @ most[joint]
            found.axes[node] = axis / np.linalg.norm(axis)
            along = own @ found.axes[node]
            found.middles[node] = _middle(along)
            parts += [own[along <= found.middles[node]], own[along > found.middles[node]]]
        return found

    def at(self, position: FloatArray) -> IntArray:
        """Return in which region poses (T, n) [rad] are, (T,)."""
        node = np.zeros(len(position), dtype=np.int64)
        for _ in range(_LEVELS):
            along = np.einsum("ti,ti->t", position, self.axes[node])
            node = 2 * node + 1 + (along > self.middles[node])
        return node - self.middles.size


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
