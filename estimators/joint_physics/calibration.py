"""Calibrate the standard deviation of joint physics, and fade what it learned far from the data.

    variance of the error = c (σ² + g x Σ xᵀ)

with the noise σ² and the covariance Σ of the weights, that of their posterior and that of the
jackknife. The factor c of each joint is such that 95 % of the errors on folds of time left out are
within 1.96 standard deviations (split conformal prediction) by the posterior alone: those folds
took part in the jackknife, and other motion is less like the data than they are. Folds of a short
recording are alike: while one has fewer rows than there are weights, c is at least 1, so that they
may widen the interval but not narrow it. The growth g, of at least 1, is such that the same holds
on regions of the poses left out, where the leverage x Σ xᵀ is that of other motion.

What the simulation leaves has a usual size, the mean square s² in training. Learned torque m with
variance v = c g x Σ xᵀ becomes

    m / (1 + (v / 2 s²)²),

which is m where the weights are known better than the simulation, half of it where they are so
unsure that zero errs as little, and fades to the simulation beyond. The standard deviation does not
fade: on other motion the simulation may leave more than it usually does.

What friction grows by with speed stays, beyond the fastest speed of training, what it is there. Of
what it does beyond, nothing is known: the variance grows by s² times the square of how much faster
the joint is, as a part of that speed.

Motion is outside where it is a tenth faster, where v is above s², so that the weights leave more
open than the simulation did, or where the leverage shows next to the noise and s², and is beyond
nearly all of what the folds were judged on: the formula still holds there, and no error has
confirmed it.

Source: MacKay, "Bayesian interpolation", Neural Computation 1992, sec. 6 (error bars); Lei et al.,
"Distribution-free predictive inference for regression", JASA 2018 (the factor); James and Stein,
"Estimation with quadratic loss", 1961 (the part that is kept).

Physics of a joint in several sets of families, mixed as far as motion left out confirms each.

Evidence decides which families a joint has on the motion at hand. Errors of the rigid body and of
gains may explain as much of it as friction does, and are N m elsewhere. So a joint is fitted with
several sets of families, and each predicts every region of the poses and every fold of time by a
fit to the others. The shares g ≥ 0 of the sets, of a sum of at most 1, minimise the squared error,

    Σ_r |y_r - Σ_k g_k X_r w_k(r)|² / |y_r|²,

in which each region and fold counts the same. What is left to 1 is the simulation's own. All
shares shrink by the part of the improvement that could be luck (`confirmed_shares` of
`estimators.regression.empirical_bayes`). Of what is used, half is this mixture, and half the set of
all families, which the evidence of all rows speaks for: both are unsure, of different things.

The weights are the mixed ones. Their covariance has that of each set and how far the sets differ.

Source: Breiman, "Stacked regressions", Machine Learning 1996 (the shares); Hoeting, Madigan,
Raftery and Volinsky, "Bayesian model averaging", Statistical Science 1999 (the covariance).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.base import DEVIATIONS
from estimators.regression.empirical_bayes import (
    LEAST_NOISE,
    RegionalFit,
    WeightPosterior,
    confirmed_shares,
    fit,
)
from estimators.regression.evidence import NormalEquations
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.joint_physics.columns import JointColumns
    from estimators.joint_physics.normal_equations import JudgedRows, MotionEquations
    from limo_driver.types import BoolArray, FloatArray, IntArray

COVERAGE: Final = 0.95
_INSIDE: Final = 0.999  # of the judged rows
_SHOWS: Final = 0.1  # [σ²]; a smaller leverage adds less than 5 % to the standard deviation
_MATTERS: Final = 0.01  # [s²]; a smaller leverage is within a tenth of what is learned
_HALF: Final = 2.0  # [s²], variance at which half of what is learned is left
FASTER: Final = 0.1  # than the fastest, as a part of it, from which on motion is outside
_SLOWEST: Final = 1e-6  # [rad/s]
_LEAST_LEVERAGE: Final = 1e-12  # [N² m²]


@dataclass(frozen=True)
class Calibration:
    """Of n joints."""

    noise: FloatArray  # (n,) [N² m²], σ²
    factor: FloatArray  # (n,), c
    growth: FloatArray  # (n,), g
    usual: FloatArray  # (n,) [N² m²], s², mean square of what the simulation leaves
    farthest: FloatArray  # (n,) [N² m²], leverage from which on motion is outside
    power: FloatArray  # (n,) of what it fades with: 2; 1 in folders from before
    fastest: FloatArray  # (n,) [rad/s], in training

    @cached_property
    def certain(self) -> FloatArray:
        """Variance where the weights are known, (n,) [N² m²]."""
        return self.factor * self.noise

    @cached_property
    def unsure(self) -> FloatArray:
        """What of a leverage is variance, (n,)."""
        return self.factor * self.growth

    @cached_property
    def fading(self) -> FloatArray:
        """How learned torque fades with leverage, and with its square, (2, n)."""
        part, square = self.unsure / (_HALF * self.usual), self.power > 1.0
        return np.array([np.where(square, 0.0, part / 2.0), np.where(square, part**2, 0.0)])

    @cached_property
    def rows(self) -> FloatArray:
        """What turns torque and leverage into an estimate, for compiled code, (7, n).

        The variance where weights are known, what of a leverage is variance, the leverage from
        which on motion is outside, how learned torque fades with it, the usual size of what the
        simulation leaves, and the fastest speed.
        """
        own = self.certain, self.unsure, self.farthest
        return np.array([*own, *self.fading, self.usual, self.fastest])


@compiled(reads=("rows", "leverage", "turned", "velocity"), nogil=True)
def judge(
    rows: FloatArray,
    leverage: FloatArray,
    turned: FloatArray,
    velocity: FloatArray,
    settled: float,
    learned: FloatArray,
    std: FloatArray,
    outside: BoolArray,
) -> None:
    """Fade the learned torque of T samples, and say how sure it is, in place.

    Args:
        rows: Of a `Calibration`.
        leverage: (T, n) [N² m²].
        turned: Range that each joint has turned in so far, (T, n) [rad].
        velocity: (T, n) [rad/s].
        settled: That it has to have turned in [rad], or else is outside.
        learned: (T, n) [N m].
        std: (T, n), variance by what nobody knows of memory [N² m²]; becomes the deviation [N m].
        outside: (T, n), written.
    """
    certain, unsure, farthest, once, twice = rows[0], rows[1], rows[2], rows[3], rows[4]
    usual, fastest = rows[5], rows[6]
    for t in range(leverage.shape[0]):
        for j in range(leverage.shape[1]):
            own = leverage[t, j]
            faster = max(abs(velocity[t, j]) / fastest[j] - 1.0, 0.0)
            unknown = std[t, j] + usual[j] * faster * faster
            std[t, j] = np.sqrt(certain[j] + unsure[j] * own + unknown)
            learned[t, j] /= 1.0 + (once[j] + twice[j] * own) * own
            outside[t, j] = own > farthest[j] or not turned[t, j] > settled or faster > FASTER


def calibrate(
    sums: MotionEquations, columns: JointColumns, fits: Sequence[RegionalFit], usual: FloatArray
) -> Calibration:
    """Judge each joint's fits without a part of the motion on the rows of that part.

    Args:
        sums: Of what is fitted.
        columns: The columns.
        fits: Of each joint.
        usual: Mean square of what the simulation leaves, (n,) [N² m²].
    """
    least = np.where(np.all(sums.folds.count >= columns.count, axis=0), 0.0, 1.0)
    speed = sums.judged.columns[:, :, columns.of_family("viscous").start]
    fastest = np.maximum(np.abs(speed).max(axis=1).astype(np.float64), _SLOWEST)
    usual = np.maximum(usual, LEAST_NOISE)
    found = [
        _calibrate_joint(sums, fit, j, float(least[j]), float(usual[j]))
        for j, fit in enumerate(fits)
    ]
    values = (np.array(values) for values in zip(*found, strict=True))
    return Calibration(*values, power=np.full(len(fits), 2.0), fastest=fastest)


def leverage_of(x: FloatArray, root: FloatArray) -> FloatArray:
    """Return x Σ xᵀ of rows (T, K), the variance that unsure weights give the torque, (T,)."""
    return np.sum((x @ root.T) ** 2, axis=1)


@dataclass(frozen=True)
class _Judged:
    """Settled rows of one joint, by fits without the part that each is in."""

    error: FloatArray  # (T,) [N m]
    leverage: FloatArray  # (T,) [N² m²], by the posterior
    added: FloatArray  # (T,) [N² m²], what the jackknife adds

    @classmethod
    def of(
        cls,
        judged: JudgedRows,
        part: IntArray,
        joint: int,
        without: Sequence[WeightPosterior],
        spread: FloatArray,
    ) -> _Judged:
        error, leverage = judged.residual[:, joint].copy(), np.zeros(part.size)
        added = np.zeros(part.size)
        for p, found in enumerate(without):
            rows = part == p
            x = judged.columns[joint, rows].astype(np.float64)
            error[rows] -= x @ found.weights
            leverage[rows], added[rows] = leverage_of(x, found.root), leverage_of(x, spread)
        settled = judged.settled[:, joint]
        return cls(error[settled], leverage[settled], added[settled])


def _calibrate_joint(
    sums: MotionEquations, fit: RegionalFit, joint: int, least: float, usual: float
) -> tuple[float, float, float, float, float]:
    """Return noise, factor, growth, usual size and farthest leverage of one joint."""
    rows, noise = sums.judged, fit.prior.noise
    folds = [fit.again(rest) for rest in sums.folds.each_left_out(joint)]
    near = _Judged.of(rows, rows.fold, joint, folds, fit.spread)
    far = _Judged.of(rows, rows.region, joint, fit.without, fit.spread)
    deviations = np.abs(near.error) / np.sqrt(noise + near.leverage)
    factor = max(float(np.quantile(deviations, COVERAGE) / DEVIATIONS) ** 2, least)
    excess = (far.error / DEVIATIONS) ** 2 / factor - noise
    growth = float(np.quantile(excess / np.maximum(far.leverage, _LEAST_LEVERAGE), COVERAGE))
    growth = max(growth, 1.0)
    shows = max(_SHOWS * noise, _MATTERS * usual)
    beyond = max(float(np.quantile(near.leverage + near.added, _INSIDE)), shows)
    return noise, factor, growth, usual, min(beyond, usual / (factor * growth))


_BODY: Final = ("rigid", "gain")
_OWN: Final = ("offset", "friction", "viscous", "place")
_LEAST: Final = 1e-12  # [N² m²], of a region


@dataclass(frozen=True)
class FamilySet:
    """A joint fitted with some of its families."""

    columns: IntArray
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
    half = (shares + np.eye(shares.size)[0]) / 2.0  # the first set has all families
    shares = half if learns and shares.any() else np.zeros_like(shares)
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


def _some(equations: NormalEquations, at: IntArray) -> NormalEquations:
    """Return the sums of some columns."""
    return NormalEquations(
        equations.gram[np.ix_(at, at)], equations.product[at], equations.energy, equations.rows
    )


def _sets(columns: JointColumns) -> list[IntArray]:
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
