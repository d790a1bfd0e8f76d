"""Bayesian linear regression of one joint, with a prior variance for each family of columns.

    y = x·w + e,  e ~ N(0, σ²),  w_k ~ N(0, 1 / α_f(k)),  columns scaled to a mean square of one

The variances are those that make the data most probable (MacKay's fixed point), so that a family
that explains nothing is switched off and none has to be chosen by hand. Weights of which it is
known how large they are keep that.

Source: MacKay, "Bayesian interpolation", Neural Computation 1992; Tipping, "Sparse Bayesian
learning and the relevance vector machine", JMLR 2001.

Shares of predictions that motion left out confirms.

The shares g ≥ 0 of k predictions, of a sum of at most 1, minimise the squared error on all parts of
the motion, each predicted by who did not see it. They shrink by what could be luck: with the mean m
of what each part gains by the shares of the other parts, and its standard error s, by 1 - (SURE s /
m)², and to nothing where that is negative.

Source: Breiman, "Stacked regressions", Machine Learning 1996; James and Stein, "Estimation with
quadratic loss", 1961 (the part that is kept).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import nnls

from estimators.regression.definite import first_best, inverse_root, jackknife

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.regression.evidence import NormalEquations
    from limo_driver.types import FloatArray, IntArray

_ITERATIONS: Final = 20
_WORTHS: Final = (0.3, 0.1, 0.03, 0.01, 0.003)  # of a row
_PRECISION: Final = (1e-3, 1e9)  # of a prior [1/(N m)²]; the widest is 30 N m of one column
LEAST_NOISE: Final = 1e-6  # [N² m²], so that exact data keep finite weights
_ZERO: Final = 1e-9  # root mean square, below which a column is zero


@dataclass(frozen=True)
class Hyperparameters:
    """Of the prior of each weight, N(0, 1 / precision) of the scaled column, and of the noise."""

    scale: FloatArray  # (K,), root mean square of each column; inf of one that is zero
    precision: FloatArray  # (K,) [1/(N m)²]
    noise: float  # σ² [N² m²]


@dataclass(frozen=True)
class WeightPosterior:
    """Weights of the columns and how well they are known."""

    weights: FloatArray  # (K,), of columns as they come
    root: FloatArray  # (K, K), R with covariance Rᵀ R


def posterior(equations: NormalEquations, prior: Hyperparameters) -> WeightPosterior:
    """Return the weights that the data of one joint say under a prior."""
    S = 1.0 / prior.scale
    P = equations.gram * np.outer(S, S) / prior.noise + np.diag(prior.precision)
    root = inverse_root(P)
    weights = root.T @ (root @ (equations.product * S)) / prior.noise
    return WeightPosterior(weights * S, root * S)


def most_probable_prior(
    equations: NormalEquations, family: IntArray, known: FloatArray | None = None
) -> Hyperparameters:
    """Find the prior variance of each family (K,) and the noise that the data speak for most.

    Weights whose deviation (K,) is known keep it; of the others it is NaN.
    """
    scale = np.where(equations.rms > _ZERO, equations.rms, np.inf)
    back = np.where(np.isfinite(scale), scale, 0.0)
    deviation = np.full(family.size, np.nan) if known is None else known * scale  # [N m]
    free = ~np.isfinite(deviation)
    stated = 1.0 / np.where(free, 1.0, deviation) ** 2
    alpha = np.ones(int(family.max()) + 1)
    noise = max(0.1 * equations.energy / equations.rows, LEAST_NOISE)
    precision = np.where(free, alpha[family], stated)
    for _ in range(_ITERATIONS):
        found = posterior(equations, Hyperparameters(scale, precision, noise))
        variance = np.sum((found.root * back) ** 2, axis=0)
        variance[back == 0] = 1.0 / precision[back == 0]  # the data say nothing
        determined = 1.0 - precision * variance
        energy = np.bincount(family, free * (found.weights * back) ** 2)
        count = np.bincount(family, free * determined)
        alpha = np.clip(np.maximum(count, 1e-6) / np.maximum(energy, 1e-12), *_PRECISION)
        rest = max(equations.rows - float(determined.sum()), 1.0)
        noise = max(equations.error(found.weights) / rest, LEAST_NOISE)
        precision = np.where(free, alpha[family], stated)
    return Hyperparameters(scale, precision, noise)


def _widened(found: WeightPosterior, spread: FloatArray) -> WeightPosterior:
    """Add the covariance Dᵀ D of a spread D (F, K) to that of the weights."""
    known = np.flatnonzero(found.root.any(axis=0))  # others are of columns that are zero
    both = np.concatenate([found.root, spread])[:, known]
    root = np.zeros(found.root.shape)
    # factored from the last column on, which keeps the root a lower triangle
    root[np.ix_(known, known)] = np.linalg.qr(both[:, ::-1]).R[::-1, ::-1]
    return WeightPosterior(found.weights, root)


@dataclass(frozen=True)
class RegionalFit:
    """Posterior of all rows, those without each region, and what they share.

    The posterior is that of a true model. What the columns cannot explain moves the weights by more
    from one region to another, which the jackknife shows: its covariance is added, so that little
    data, of few parts of the range, are not taken for more than they are.
    """

    posterior: WeightPosterior  # with the covariance of the jackknife
    without: tuple[WeightPosterior, ...]
    prior: Hyperparameters
    worth: float  # of a row
    held_out: float  # mean square error on the regions left out [N² m²]
    spread: FloatArray  # (R, K), D with the jackknife's covariance Dᵀ D

    def again(self, equations: NormalEquations) -> WeightPosterior:
        """Return the posterior of other rows, under the same prior and worth."""
        return posterior(equations.worth(self.worth), self.prior)


def fit(
    everything: NormalEquations,
    regions: Sequence[NormalEquations],
    family: IntArray,
    known: FloatArray | None = None,
) -> RegionalFit:
    """Fit one joint, taking rows for as much evidence as motion of other regions confirms.

    What the columns cannot explain lasts longer than a sample, so that a row is worth less than an
    independent one. Of several worths the one counts whose fits without a region are off least
    there: neighbours in time confirm what is true of their own poses only.

    Args:
        everything: All rows.
        regions: The rows without each region.
        family: Which family each column is of, (K,).
        known: Standard deviations of weights before any data, (K,); NaN where the data decide.
    """
    candidates: list[RegionalFit] = []
    for worth in _WORTHS:
        prior = most_probable_prior(everything.worth(worth), family, known)
        without = tuple(posterior(rest.worth(worth), prior) for rest in regions)
        error = sum(
            max(everything.error(fitted.weights) - rest.error(fitted.weights), 0.0)
            for rest, fitted in zip(regions, without, strict=True)
        )
        spread = jackknife([found.weights for found in without])
        found = _widened(posterior(everything.worth(worth), prior), spread)
        candidates.append(
            RegionalFit(found, without, prior, worth, error / everything.rows, spread)
        )
    # in units of the least noise, beside which rounding is nothing
    return first_best(candidates, lambda candidate: -candidate.held_out / LEAST_NOISE)


SURE: Final = 1.5  # standard errors that an improvement has to have
_RIDGE: Final = 1e-6  # of the mean square of a prediction, so that predictions alike share alike
_TIGHT: Final = 1e3  # weight of the row that keeps shares from more than 1
_FEWEST: Final = 2  # parts, that tell luck from more


def confirmed_shares(errors: Sequence[FloatArray]) -> FloatArray:
    """Return the shares of k predictions that r parts of the motion confirm, (k,).

    Args:
        errors: Of each of r parts the products [[A, b], [b, c]] (k + 1, k + 1) of what is predicted
            and of what is to be, in the same units.
    """
    every = np.array(errors)
    shares = _shares(every.sum(axis=0))
    regions = range(len(every))
    if len(every) < _FEWEST or not shares.any():
        return np.zeros_like(shares)
    gained = np.array(
        [every[r, -1, -1] - _error(every[r], _shares(_rest(every, r))) for r in regions]
    )
    mean, unsure = gained.mean(), gained.std(ddof=1) / np.sqrt(len(gained))
    if mean <= SURE * unsure:
        return np.zeros_like(shares)
    return shares * (1.0 - (SURE * unsure / mean) ** 2)


def _rest(every: FloatArray, part: int) -> FloatArray:
    """Return the sum of all products but those of a part."""
    return np.delete(every, part, axis=0).sum(axis=0)


def _shares(products: FloatArray) -> FloatArray:
    """Return g ≥ 0, of a sum of at most 1, that minimises gᵀ A g - 2 b·g."""
    k = len(products) - 1
    size = float(np.trace(products[:k, :k])) / k
    if not size > 0:
        return np.zeros(k)
    upper = np.linalg.cholesky(products[:k, :k] + _RIDGE * size * np.eye(k)).T
    wanted = np.linalg.solve(upper.T, products[:k, k])
    found = nnls(upper, wanted)[0]
    if found.sum() > 1.0:
        row = _TIGHT * np.sqrt(size)
        found = nnls(np.vstack([upper, np.full(k, row)]), np.append(wanted, row))[0]
        found /= max(found.sum(), 1.0)
    return found


def _error(products: FloatArray, shares: FloatArray) -> float:
    """Return the squared error of a mixture."""
    k = len(shares)
    return float(products[k, k] - 2 * shares @ products[:k, k] + shares @ products[:k, :k] @ shares)
