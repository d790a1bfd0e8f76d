"""Normal equations of torque in the full parameters, accumulated joint by joint over chunks.

What a fit needs of any number of samples is, for each joint, the Gram matrix of its regressor,
its product with the torque, and the torque's energy: a few MB. Other weights of the joints, other
priors or a fit without some of the rows need no second pass over the data.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from estimators.base import check_recordings, joints_with_torque
from estimators.rigid_body.fitting.effective_rows import (
    FOLDS,
    ThinnedRows,
    blocks_of,
    effective_rows,
    fold_of,
)
from estimators.rigid_body.regressor import RegressorChain
from limo_driver.errors import RecordingError
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.recordings.filters.differentiation import smooth
from limo_driver.runtime.parameters import Declared, parameter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from estimators.rigid_body.terms import JointTerms
    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import BoolArray, FloatArray, IntArray

CHUNK = 1024  # samples whose regressor is held at a time; it stays in the processor's cache
BLOCK = 65536  # samples filtered at a time
WEIGHTINGS = ("error", "torque")
_MEMORY = 6.0  # [1/bandwidth] after which the filter has forgotten all but 5e-7
_DENSE = 8  # rows summed per 1/bandwidth; filtered products hold nothing that more would show
MOVING = 0.02  # [rad/s], above which a joint counts as moving


@dataclass(frozen=True)
class Rows(Declared):
    """Measured rows of a fit, their filter and their weights.

    Args:
        bandwidth: Of the zero-phase filter on position and torque [Hz].
        moving_only: Leave out, joint by joint, rows at which the joint rests. At rest, a torque
            measured on the motor side may lie anywhere within the friction band.
        weighting: Each joint's rows count by the inverse variance of their `error` (the maximum
            likelihood, found by iteration) or of the `torque` (every joint's relative error
            counts the same).

    Raises:
        ConfigError: No such weighting or bandwidth.

    Example:
        >>> limo.identify("iiwa14", "run.parquet", rows=limo.Rows(8.0, moving_only=True))
    """

    bandwidth: float = parameter("Hz", lower=0, above=True, default=BANDWIDTH)
    moving_only: bool = False
    weighting: str = parameter(of=WEIGHTINGS, default="error")


@dataclass(frozen=True)
class ArmEquations:
    """Sums over the rows of each fold, for each of n joints and p full parameters.

    As accumulated, there is one Coulomb column for each sign width; `choose` leaves one.
    """

    gram_of_fold: FloatArray  # (FOLDS, n, p, p), Σ y yᵀ
    product_of_fold: FloatArray  # (FOLDS, n, p), Σ y tau
    energy: FloatArray  # (n,), Σ tau² [N² m²]
    count: FloatArray  # (n,), rows summed
    thinned: ThinnedRows  # a few of the rows, with the same columns
    chain: RegressorChain
    weighting: str  # of the joints, as in `Rows`

    @cached_property
    def gram(self) -> FloatArray:
        """Sum of y yᵀ over all rows, (n, p, p)."""
        return self.gram_of_fold.sum(axis=0)

    @cached_property
    def product(self) -> FloatArray:
        """Sum of y tau over all rows, (n, p)."""
        return self.product_of_fold.sum(axis=0)

    def weighted(
        self, weight: FloatArray, without: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return Σ weight gram (p, p) and Σ weight product (p,) for one weight a joint.

        Args:
            weight: (n,) [1/(N m)²].
            without: Fold whose rows are left out.
        """
        gram, product = self.gram, self.product
        if without is not None:
            gram = gram - self.gram_of_fold[without]
            product = product - self.product_of_fold[without]
        return np.tensordot(weight, gram, 1), weight @ product

    def rmse(self, parameters: FloatArray) -> FloatArray:
        """Return the root mean square error of each joint (n,) [N m] of full parameters (p,)."""
        explained = self.gram @ parameters
        error = self.energy - 2 * self.product @ parameters + explained @ parameters
        return np.sqrt(np.maximum(error, 0.0) / np.maximum(self.count, 1))

    def effective_rows(self, parameters: FloatArray) -> FloatArray:
        """Return how many independent rows each joint's are worth, (n,), by their errors."""
        return effective_rows(self.chain, self.thinned, self.mean_gram(), parameters)

    def mean_gram(self) -> FloatArray:
        """Return the mean of y yᵀ over each joint's rows, (n, p, p)."""
        return self.gram / np.maximum(self.count, 1)[:, None, None]

    def choose(self, terms: JointTerms, choice: Sequence[int]) -> ArmEquations:
        """Return the equations with one sign width, by its index, for each joint."""
        n = self.count.size
        links, own = self.chain.width, len(terms.all())
        columns = np.tile(np.arange(own), (n, 1))
        coulomb = [term.effect for term in terms.all()].index("coulomb_friction")
        columns[:, coulomb] = [own + index - 1 if index else coulomb for index in choice]
        at = np.concatenate([np.arange(links), (links + n * columns.T + np.arange(n)).ravel()])
        return replace(
            self,
            gram_of_fold=self.gram_of_fold[:, :, at[:, None], at[None, :]],
            product_of_fold=self.product_of_fold[:, :, at],
            thinned=self.thinned.choose(columns),
        )


def accumulate(
    model: RobotModel,
    terms: JointTerms,
    recordings: Sequence[Recording],
    rows: Rows,
    progress: Callable[[int], None] | None = None,
) -> ArmEquations:
    """Sum up the normal equations of recordings, holding the regressor of one chunk at a time.

    Every row is filtered; of recordings much faster than the bandwidth, every few are summed.

    Args:
        model: The robot.
        terms: What is modelled beside the inertias.
        recordings: Measured motions and torques.
        rows: Which rows are used.
        progress: Called with the number of samples done since the last call.

    Raises:
        RecordingError: There is no recording, one is of another robot or given twice, nothing
            moves, no torque was measured, or no row is left.
    """
    check_recordings(recordings, model)
    sums = _Sums(model, terms)
    for recording in recordings:
        for done in sums.add(recording, rows):
            if progress is not None:
                progress(done)
    if not sums.count.any():
        raise RecordingError("no row is left to fit to: nothing moves, or the stretches are short")
    gram, product = sums.symmetric()
    thinned = ThinnedRows.joined(sums.thinned)
    return ArmEquations(gram, product, sums.energy, sums.count, thinned, sums.chain, rows.weighting)


@dataclass(frozen=True)
class _Places:
    """Times of samples, each array (T,)."""

    block: IntArray  # of time, longer than errors remember
    fold: IntArray

    def __getitem__(self, rows: slice) -> _Places:
        return _Places(self.block[rows], self.fold[rows])


def _chunks(fold: IntArray) -> Iterator[slice]:
    """Cut rows into chunks of one fold each."""
    ends = [*(np.flatnonzero(np.diff(fold)) + 1).tolist(), fold.size]
    start = 0
    for end in ends:
        while start < end:
            yield slice(start, min(start + CHUNK, end))
            start = min(start + CHUNK, end)


class _Sums:
    """The running sums; each joint's columns are its own links' and its own terms'."""

    def __init__(self, model: RobotModel, terms: JointTerms) -> None:
        self.model, self.terms = model, terms
        self.chain = RegressorChain.of(model)
        self.n = model.n
        self.links = self.chain.width
        self.own = len(terms.all()) + len(terms.sign_widths) - 1
        width = self.links + self.own
        widths = [width - self.chain.first(j) for j in range(self.n)]
        self.gram = [np.zeros((FOLDS, width, width)) for width in widths]
        self.product = [np.zeros((FOLDS, width)) for width in widths]
        self.energy, self.count = np.zeros(self.n), np.zeros(self.n)
        self.thinned: list[ThinnedRows] = []
        self._Y = np.zeros((self.n, CHUNK, width))

    def add(self, recording: Recording, rows: Rows) -> Iterator[int]:
        """Add one recording block by block, and say how many samples each was.

        Each block is filtered with as much before and after it as the filter remembers.
        """
        halo = int(np.ceil(_MEMORY / rows.bandwidth * recording.rate))
        inside = ~recording.edges(rows.bandwidth)
        places = _Places(blocks_of(recording), fold_of(recording))
        measured = joints_with_torque(self.model, recording)
        for start in range(0, len(recording), BLOCK):
            stop = min(start + BLOCK, len(recording))
            first = max(0, start - halo)
            last = min(stop + halo, len(recording))
            use = np.zeros(last - first, dtype=bool)
            use[start - first : stop - first] = inside[start:stop]
            piece = recording[first:last]
            self._add_block(piece, use, places[first:last], measured, rows)
            yield stop - start

    def _add_block(
        self, piece: Recording, use: BoolArray, places: _Places, measured: BoolArray, rows: Rows
    ) -> None:
        smoothed = piece.motion(rows.bandwidth)
        step = max(1, int(piece.rate / (_DENSE * rows.bandwidth)))
        kept = np.flatnonzero(use)[::step]
        # The joint terms' columns, then the sign of every further width, (T, n, own)
        signs = [
            smooth(piece.time, np.tanh(smoothed.velocity / width), rows.bandwidth, piece.segments)
            for width in self.terms.sign_widths
        ]
        columns = self.terms.columns(smoothed.velocity, smoothed.acceleration, signs[0])
        own = np.concatenate([columns, *(sign[:, :, None] for sign in signs[1:])], axis=2)[kept]
        torque = piece.filtered_torque(rows.bandwidth)[kept]
        motion = smoothed[kept]
        count = (np.abs(motion.velocity) > MOVING) | (not rows.moving_only)
        count &= measured
        fold = places.fold[kept]
        for chunk in _chunks(fold):
            T, used, k = chunk.stop - chunk.start, count[chunk], int(fold[chunk.start])
            self.chain.fill(motion[chunk], self._Y)
            self._Y[:, :T, self.links :] = own[chunk].transpose(1, 0, 2)
            for j in range(self.n):
                y, tau = self._Y[j, :T, self.chain.first(j) :], torque[chunk, j]
                if not used[:, j].all():
                    y, tau = y[used[:, j]], tau[used[:, j]]
                self.gram[j][k] += y.T @ y
                self.product[j][k] += y.T @ tau
                self.energy[j] += tau @ tau
                self.count[j] += tau.size
        independent = max(1, int(piece.rate / (2 * rows.bandwidth)) // step)
        few = np.arange(0, len(motion), independent)
        self.thinned.append(
            ThinnedRows(motion[few], own[few], torque[few], count[few], places.block[kept][few])
        )

    def symmetric(self) -> tuple[FloatArray, FloatArray]:
        """Spread each joint's sums over the full parameters, (FOLDS, n, p, p), (FOLDS, n, p)."""
        p = self.links + self.n * self.own
        gram, product = np.zeros((FOLDS, self.n, p, p)), np.zeros((FOLDS, self.n, p))
        for j in range(self.n):
            at = np.concatenate(
                [
                    np.arange(self.chain.first(j), self.links),
                    self.links + j + self.n * np.arange(self.own),
                ]
            )
            gram[:, j, at[:, None], at] = self.gram[j]
            product[:, j, at] = self.product[j]
        return gram, product
