"""Rotation: residuals of rows that were held out in turn, so that all of a recording can judge.

Whether a gain is sure asks for many blocks of time. Friction that builds up shows at reversals, and
the blocks held out of a short recording have but one or two of these. So each block is held out
once, but the first and the last, and a set is fitted to what is left. Its settings, which the
torque is not linear in, stay: they were refined on other rows than the proof's.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.selection.columns import ColumnTable, normal_equations
from estimators.diagnosis.held_out import Split
from estimators.diagnosis.settings.residuals import HELD_OUT
from estimators.regression.evidence import Prior, posterior

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.noise import Noise
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.regression.normal_equations import NormalEquations
    from limo_driver.types import FloatArray


@dataclass
class Rotation:
    """Sums over the rows that are fitted in each turn, of some columns under one noise."""

    noise: Noise
    splits: tuple[Split, ...]
    columns: ColumnTable  # those of the nuisance first, then others
    place: dict[int, int]  # of a column of the whole table, among these
    nuisance: Prior  # of these columns
    target: FloatArray  # (K, n) [N m]
    sums: tuple[NormalEquations, ...]
    _left: dict[tuple[bytes, bytes], FloatArray] = field(
        default_factory=dict[tuple[bytes, bytes], "FloatArray"], init=False
    )

    @classmethod
    def of(
        cls,
        observed: Observations,
        columns: ColumnTable,
        target: FloatArray,
        noise: Noise,
        nuisance: Prior,
        others: NDArray[np.int64],
    ) -> Rotation:
        """Sum over the rows of each turn.

        Args:
            observed: Recordings and simulation.
            columns: The table.
            target: What the columns have to sum up to, (K, n) [N m].
            noise: Of each joint.
            nuisance: Columns that are in every set.
            others: Further columns that sets may have, (c,).
        """
        index = np.unique(np.concatenate([nuisance.index, others]))
        some = columns.only(index)
        place = {int(column): k for k, column in enumerate(index)}
        own = replace(nuisance, index=_placed(place, nuisance.index))
        blocks = ([block + turn for block in HELD_OUT.which] for turn in HELD_OUT.turns)
        splits = tuple(Split.of(observed, which) for which in blocks)
        sums = tuple(
            normal_equations(some, target, noise.over(split.fitted, observed.segment), split.fitted)
            for split in splits
        )
        return cls(noise, splits, some, place, own, target, sums)

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """Mark the rows (K, n) that are held out in some turn."""
        return np.any([split.held_out for split in self.splits], axis=0)

    def has(self, noise: Noise, index: NDArray[np.int64]) -> bool:
        """Say whether these are sums of some columns (c,), under that noise."""
        return self.noise is noise and all(int(column) in self.place for column in index)

    def left(self, prior: Prior) -> FloatArray:
        """Return what a set of columns leaves of rows held out, (K, n) [N m]; 0 elsewhere."""
        own = replace(prior, index=_placed(self.place, prior.index))
        key = own.index.tobytes(), own.deviation.tobytes()
        if key not in self._left:
            result = np.zeros_like(self.target)
            for split, sums in zip(self.splits, self.sums, strict=True):
                fitted = posterior(sums, self.nuisance, own)
                rest = self.target - self.columns.apply(fitted.index, fitted.mean)
                result = np.where(split.held_out, rest, result)
            self._left[key] = result
        return self._left[key]


def _placed(place: dict[int, int], index: Sequence[int] | NDArray[np.int64]) -> NDArray[np.int64]:
    return np.array([place[int(column)] for column in index], dtype=np.int64)
