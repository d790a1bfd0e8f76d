"""Physics of a joint in several sets of families, mixed as far as motion left out confirms each.

Evidence decides which families a joint has on the motion at hand. Errors of the rigid body and of
gains may explain as much of it as friction does, and are N m elsewhere. So a joint is fitted with
several sets of families, and each predicts every region of the poses and every fold of time by a
fit to the others. The shares g ≥ 0 of the sets, of a sum of at most 1, minimise the squared error,

    Σ_r |y_r - Σ_k g_k X_r w_k(r)|² / |y_r|²,

in which each region and fold counts the same. What is left to 1 is the simulation's own. All
shares shrink by the part of the improvement that could be luck (`estimators.regression.shares`).

The weights are the mixed ones. Their covariance has that of each set and how far the sets differ.

Source: Breiman, "Stacked regressions", Machine Learning 1996 (the shares); Hoeting, Madigan,
Raftery and Volinsky, "Bayesian model averaging", Statistical Science 1999 (the covariance).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.regression.empirical_bayes import RegionalFit, WeightPosterior, fit
from estimators.regression.evidence import NormalEquations
from estimators.regression.shares import confirmed_shares

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.joint_physics.columns import JointColumns
    from estimators.joint_physics.normal_equations import MotionEquations
    from limo_driver.types import FloatArray

_BODY: Final = ("rigid", "gain")
_OWN: Final = ("offset", "friction", "viscous", "place")
_LEAST: Final = 1e-12  # [N² m²], of a region


@dataclass(frozen=True)
class FamilySet:
    """A joint fitted with some of its families."""

    columns: NDArray[np.int64]
    fit: RegionalFit

    def whole(self, found: WeightPosterior, count: int) -> WeightPosterior:
        """Return a posterior of all columns, zero of those that are left out."""
        weights, root = np.zeros(count), np.zeros((found.root.shape[0], count))
        weights[self.columns], root[:, self.columns] = found.weights, found.root
        return WeightPosterior(weights, root)


@dataclass(frozen=True)
class ConfirmedFit(RegionalFit):
    """A mixture of fits, used as one."""

    sets: tuple[FamilySet, ...]
    shares: FloatArray  # (k,), at least 0, of a sum of at most 1

    def again(self, equations: NormalEquations) -> WeightPosterior:
        """Return the mixture of posteriors of other rows, under the same priors and shares."""
        count = equations.product.size
        found = [
            one.whole(one.fit.again(_some(equations, one.columns)), count) for one in self.sets
        ]
        return _mixed(found, self.shares)


def confirmed_fit(
    sums: MotionEquations,
    columns: JointColumns,
    joint: int,
    known: FloatArray,
    *,
    learns: bool = True,
) -> ConfirmedFit:
    """Fit a joint in all sets of families, and mix them.

    Args:
        sums: Of all rows, by folds of time and by regions.
        columns: The columns.
        joint: 0-based.
        known: Standard deviations of weights before any data, (K,); NaN where the data decide.
        learns: Else no set has a share.
    """
    everything, rest = sums.regions.equations(joint), sums.regions.each_left_out(joint)
    parts = [sums.regions.of_part(joint, part) for part in range(len(rest))]
    sets: list[FamilySet] = []
    for at in _sets(columns):
        family = np.unique(columns.family[at], return_inverse=True)[1]
        found = fit(_some(everything, at), [_some(one, at) for one in rest], family, known[at])
        sets.append(FamilySet(at, found))
    count = columns.count
    by_region = [[one.whole(one.fit.without[r], count) for one in sets] for r in range(len(rest))]
    by_fold = [
        [one.whole(one.fit.again(_some(other, one.columns)), count) for one in sets]
        for other in sums.folds.each_left_out(joint)
    ]
    judges = [*parts, *(sums.folds.of_part(joint, fold) for fold in range(len(by_fold)))]
    errors = [
        _products(part, np.array([one.weights for one in found]))
        for part, found in zip(judges, [*by_region, *by_fold], strict=True)
    ]
    shares = confirmed_shares([one for one in errors if one is not None])
    shares = shares if learns else np.zeros_like(shares)
    whole = [one.whole(one.fit.posterior, count) for one in sets]
    without = tuple(_mixed(found, shares) for found in by_region)
    posterior = _mixed(whole, shares)
    left = sum(part.error(one.weights) for part, one in zip(parts, without, strict=True))
    first = sets[0].fit
    return ConfirmedFit(
        posterior,
        without,
        first.prior,
        first.worth,
        left / everything.rows,
        np.zeros((1, count)),
        tuple(sets),
        shares,
    )


def _products(part: NormalEquations, weights: FloatArray) -> FloatArray | None:
    """Return the products of what weights (k, K) predict of a region, and of its residual."""
    if not part.rows > 0:
        return None
    inner, outer = weights @ part.gram @ weights.T, weights @ part.product
    energy = part.energy + _LEAST
    return np.block([[inner, outer[:, None]], [outer[None], np.array([[energy]])]]) / energy


def _mixed(found: Sequence[WeightPosterior], shares: FloatArray) -> WeightPosterior:
    """Return the mixture of posteriors; what is left to 1 is that of weights that are zero."""
    weights = np.array([one.weights for one in found])
    mean = shares @ weights
    part = np.sqrt(np.append(shares, max(1.0 - shares.sum(), 0.0)))
    apart = part[:, None] * (np.vstack([weights, np.zeros_like(mean)]) - mean)
    roots = [np.sqrt(share) * one.root for share, one in zip(shares, found, strict=True)]
    return WeightPosterior(mean, lower_root(np.concatenate([*roots, apart])))


def lower_root(rows: FloatArray) -> FloatArray:
    """Return R (K, K), lower triangular, with Rᵀ R = Dᵀ D of rows D (m, K)."""
    count = rows.shape[1]
    known = np.flatnonzero(rows.any(axis=0))  # others are of columns that are zero
    root = np.zeros((count, count))
    if known.size:
        upper = np.linalg.qr(rows[:, known][:, ::-1]).R
        size = len(upper)
        root[np.ix_(known[known.size - size :], known)] = upper[::-1, ::-1]
    return root


def _some(equations: NormalEquations, at: NDArray[np.int64]) -> NormalEquations:
    """Return the sums of some columns."""
    return NormalEquations(
        equations.gram[np.ix_(at, at)], equations.product[at], equations.energy, equations.rows
    )


def _sets(columns: JointColumns) -> list[NDArray[np.int64]]:
    """Return the columns of each set: all; without the body's; a joint's own; of its place."""
    names = np.array([family.name for family in columns.families])[columns.family]
    own = np.isin(names, _OWN)
    masks = (
        np.ones(names.size, bool),
        ~np.isin(names, _BODY),
        own,
        np.isin(names, ("offset", "place")),
    )
    return [np.flatnonzero(mask) for mask in masks]
