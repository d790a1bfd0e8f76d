"""Evidence: how much likelier the recordings are with some effects than without.

The residual is linear in what is not known: y = N eta + A theta + e, with nuisance parameters
eta ~ N(0, diag s²) inside their tolerances, amplitudes theta ~ N(0, diag a²) of hypothesised
effects, and noise e. Nuisance parameters are integrated out once; a set of effects then costs one
small factorisation.

    log p(y | set) - log p(y | none) = ½ |L⁻¹ S d|² - Σ log L_ii,   L Lᵀ = I + S C S

with C and d the products of the set's columns after the nuisance, S = diag a.

Source: MacKay, "Bayesian interpolation", Neural Computation 1992.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from math import nan

import numpy as np
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dtrtrs  # pyright: ignore[reportAttributeAccessIssue]

from estimators.regression.definite import RIDGE, gains_beside, lower_of, of_right_signs
from limo_driver.types import BoolArray, FloatArray, IntArray

REACH = 3.0  # prior deviations of a nuisance parameter; more is a wrong parameter
_NO_BLOCKS = np.zeros(0, dtype=np.int64)
_NO_LIMITS = np.zeros(0)


@dataclass(frozen=True)
class Prior:
    """Columns and the standard deviations of their coefficients.

    Columns of one block are there together or not at all: without a mass, a body has no moments.
    """

    index: IntArray  # (c,)
    deviation: FloatArray  # (c,)
    positive: BoolArray  # (c,) coefficients that cannot be negative
    block: IntArray = field(default_factory=lambda: _NO_BLOCKS)  # (c,) rising, or one each
    most: FloatArray = field(default_factory=lambda: _NO_LIMITS)  # (c,) deviations; or without end

    def __post_init__(self) -> None:
        if self.most is _NO_LIMITS:
            object.__setattr__(self, "most", np.full(self.index.size, np.inf))
        if self.block is _NO_BLOCKS:
            object.__setattr__(self, "block", np.arange(self.index.size))

    @classmethod
    def free(cls, index: IntArray, deviation: FloatArray) -> Prior:
        """Return columns whose coefficients may have either sign."""
        return cls(index, deviation, np.zeros(index.size, dtype=bool))

    def of(self, rows: BoolArray | IntArray) -> Prior:
        """Return some of the columns."""
        return Prior(
            self.index[rows],
            self.deviation[rows],
            self.positive[rows],
            self.block[rows],
            self.most[rows],
        )

    def beside(self, wrong: BoolArray) -> BoolArray:
        """Mark the columns (c,) of blocks that have a coefficient of the wrong sign."""
        return np.isin(self.block, self.block[wrong])


@dataclass(frozen=True)
class Priors:
    """Several sets of columns, one behind the other."""

    together: Prior
    start: IntArray  # (p + 1,) where each begins, and the last ends

    @classmethod
    def of_each(cls, priors: Sequence[Prior]) -> Priors:
        """Return p sets of columns as one table."""
        start = np.cumsum([0, *(prior.index.size for prior in priors)])
        return cls(joined(*priors), start)

    def rows(self, some: Sequence[int]) -> IntArray:
        """Return the rows of some sets, one behind the other."""
        none = np.zeros(0, dtype=np.int64)
        return np.concatenate([none, *(np.arange(*self.start[[k, k + 1]]) for k in some)])


@dataclass(frozen=True)
class Posterior:
    """Coefficients of nuisance columns, then of the set's."""

    index: IntArray  # (m,)
    mean: FloatArray  # (m,)
    covariance: FloatArray  # (m, m), the product of a root; zero of what is held

    @property
    def deviation(self) -> FloatArray:
        """Standard deviations, (m,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class _Factor:
    """A set of b columns that all have the right sign, factorised."""

    prior: Prior
    lower: FloatArray  # (b, b)
    z: FloatArray  # (b,)

    @property
    def gain(self) -> float:
        """Log evidence against none."""
        return 0.5 * float(self.z @ self.z) - float(np.log(np.diag(self.lower)).sum())


class Evidence:
    """Compares sets of columns on given products.

    Args:
        products: Sums over the rows that count.
        nuisance: Columns that are in every set, with their tolerances.
        held: Coefficients (c,) of the nuisance that stay where they are; NaN where they are free.
    """

    def __init__(
        self, products: NormalEquations, nuisance: Prior, held: FloatArray | None = None
    ) -> None:
        self.products, self.nuisance = products, nuisance
        free = np.ones(nuisance.index.size, dtype=bool) if held is None else np.isnan(held)
        at, s = nuisance.index[free], nuisance.deviation[free]
        G, product = products.gram, products.product
        if held is not None and not free.all():
            product = product - G[:, nuisance.index[~free]] @ held[~free]
        inner = s[:, None] * G[np.ix_(at, at)] * s + np.eye(at.size)
        self._at, self._s = at, s
        self._lower = lower_of(inner)
        self._half = solve_triangular(self._lower, s[:, None] * G[at], lower=True)
        self.gram = G - self._half.T @ self._half
        self._b = solve_triangular(self._lower, s * product[at], lower=True)
        self.product = product - self._half.T @ self._b

    def extended(self, products: NormalEquations) -> Evidence:
        """Return the same with more columns behind those there are, where nothing is held.

        What the earlier ones make of each other is factorised already, so that many alternatives
        to the later ones cost little each.

        Args:
            products: Sums of all columns, of which the first are those of `self.products`.
        """
        count, G = self.product.size, products.gram
        half = _solved(self._lower, self._s[:, None] * G[self._at, count:])
        across = G[:count, count:] - self._half.T @ half
        own = G[count:, count:] - half.T @ half
        more = copy(self)
        more.products, more._half = products, np.hstack([self._half, half])
        more.gram = np.block([[self.gram, across], [across.T, own]])
        more.product = np.append(self.product, products.product[count:] - half.T @ self._b)
        return more

    def gain(self, prior: Prior) -> float:
        """Return the log evidence of a set of columns against none.

        Columns whose coefficient would need the other sign, or be larger than it may, are left out.
        """
        return self._factor(prior).gain

    def _factor(self, prior: Prior) -> _Factor:
        rows, lower, z = self._of_right_signs(prior, np.arange(prior.index.size))
        return _Factor(prior if rows.size == prior.index.size else prior.of(rows), lower, z)

    def _of_right_signs(
        self, table: Prior, rows: IntArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        return of_right_signs(
            self.gram,
            self.product,
            table.index,
            table.deviation,
            table.positive,
            table.most,
            table.block,
            rows,
        )

    def coefficients(self, prior: Prior) -> Posterior:
        """Return the coefficients of a set with which it competes, whatever the nuisance is.

        Those of columns that are left out are zero, and known to be.
        """
        known, size = self._factor(prior), prior.index.size
        kept = np.isin(prior.index, known.prior.index)
        half = _solved(known.lower, np.diag(known.prior.deviation))
        mean, covariance = np.zeros(size), np.zeros((size, size))
        mean[kept] = half.T @ known.z
        covariance[np.ix_(kept, kept)] = half.T @ half
        return Posterior(prior.index, mean, covariance)

    def gains(self, table: Priors, base: Sequence[int], some: IntArray) -> FloatArray:
        """Return the log evidence of some sets of a table with each of others beside them, (p,).

        The sets are factorised once, and what each of the others adds is a Schur complement.

        Args:
            table: Sets of columns.
            base: Those that are there.
            some: Those that are added (p,), one at a time.
        """
        all_of = table.together
        rows, lower, z = self._of_right_signs(all_of, table.rows(base))
        prior = all_of.of(rows)
        across = _solved(lower, prior.deviation[:, None] * self.gram[prior.index])
        back = _solved(lower, np.column_stack([z, across]), trans=1)[prior.positive]
        return gains_beside(
            rows,
            lower,
            z,
            across,
            back,
            self.gram,
            self.product,
            all_of.index,
            all_of.deviation,
            all_of.positive,
            all_of.most,
            all_of.block,
            table.start,
            some,
        )

    def posterior(self, prior: Prior) -> Posterior:
        """Return the coefficients of nuisance and set together."""
        return posterior(self.products, self.nuisance, prior)

    def at_limit(self, fitted: Posterior) -> FloatArray:
        """Return the coefficients of the nuisance (c,) that a fit has at their limit; NaN else."""
        limit = REACH * self.nuisance.deviation
        mean = fitted.mean[: limit.size]
        there = (np.abs(mean) >= (1 - RIDGE) * limit) & (limit > 0)
        return np.where(there, mean, np.nan)


def posterior(products: NormalEquations, nuisance: Prior, prior: Prior) -> Posterior:
    """Return the coefficients of nuisance columns and a set, given sums over any rows.

    Nuisance parameters stay inside `REACH` deviations: where thousands of rows outvote a prior, a
    posterior would otherwise accept what no tolerance allows. Coefficients that cannot be negative
    are zero where they would be, with all of their block; those that have a most are that at most.
    """
    both = joined(nuisance, prior)
    s, count = both.deviation, nuisance.index.size
    M = s[:, None] * products.gram[np.ix_(both.index, both.index)] * s
    M.flat[:: s.size + 1] += 1.0 + RIDGE
    c = s * products.product[both.index]
    high = np.where(np.arange(s.size) < count, REACH, both.most)
    low = np.where(both.positive, 0.0, -high)
    x, free = np.zeros(s.size), np.ones(s.size, dtype=bool)
    while True:
        lower = lower_of(M[np.ix_(free, free)])
        found = cho_solve((lower, True), c[free] - M[np.ix_(free, ~free)] @ x[~free])
        x[free] = np.clip(found, low[free], high[free])
        outside = np.zeros_like(free)
        outside[free] = x[free] != found
        if not outside.any():
            break
        absent = both.beside(outside & both.positive & (x == low))  # of a body without mass
        x[absent] = 0.0
        free &= ~(outside | absent)
    covariance = np.zeros((s.size, s.size))
    root = solve_triangular(lower, np.diag(s[free]), lower=True)
    covariance[np.ix_(free, free)] = root.T @ root
    return Posterior(both.index, s * x, covariance)


def _solved(lower: FloatArray, right: FloatArray, trans: int = 0) -> FloatArray:
    """Solve L x = right, or its transpose; LAPACK itself, since small systems come in thousands."""
    if not right.size:
        return right
    # its own order of memory is the transpose
    return np.asarray(dtrtrs(lower.T, right, lower=0, trans=1 - trans)[0]).reshape(right.shape)


def joined(*priors: Prior) -> Prior:
    """Return several sets of columns as one."""
    blocks, count = [np.zeros(0, dtype=np.int64)], 0
    for prior in priors:
        blocks.append(prior.block + count)
        count += int(prior.block.max(initial=-1)) + 1
    return Prior(
        np.concatenate([np.zeros(0, dtype=np.int64), *(p.index for p in priors)]),
        np.concatenate([np.zeros(0), *(p.deviation for p in priors)]),
        np.concatenate([np.zeros(0, dtype=bool), *(p.positive for p in priors)]),
        np.concatenate(blocks),
        np.concatenate([np.zeros(0), *(p.most for p in priors)]),
    )


@dataclass(frozen=True)
class NormalEquations:
    """Sums over rows x (K,) with targets y; rows of which errors are known count by these.

    Energy and rows are NaN where nothing asks for them.
    """

    gram: FloatArray  # (K, K), Σ x xᵀ
    product: FloatArray  # (K,), Σ x y
    energy: float = nan  # Σ y² [N² m²]
    rows: float = nan

    @classmethod
    def of(cls, x: FloatArray, y: FloatArray) -> NormalEquations:
        """Sum over rows of columns x (T, K) and residual y (T,) [N m]."""
        return cls(x.T @ x, x.T @ y, float(y @ y), float(y.size))

    @property
    def rms(self) -> FloatArray:
        """Root mean square of each column, (K,)."""
        return np.sqrt(np.diag(self.gram) / self.rows)

    def error(self, weights: FloatArray) -> float:
        """Return Σ (y - x·w)² [N² m²]; rounding makes no exact fit better than that."""
        left = self.energy + float(weights @ (self.gram @ weights - 2 * self.product))
        return max(left, 0.0)

    def worth(self, share: float) -> NormalEquations:
        """Return the same as if it were a share of the rows."""
        return NormalEquations(
            share * self.gram, share * self.product, share * self.energy, share * self.rows
        )
