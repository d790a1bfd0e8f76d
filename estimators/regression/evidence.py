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

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dtrtrs  # pyright: ignore[reportAttributeAccessIssue]

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.regression.normal_equations import NormalEquations
    from limo_driver.types import FloatArray

REACH = 3.0  # prior deviations of a nuisance parameter; more is a wrong parameter
_RIDGE = 1e-9
_NO_BLOCKS = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Prior:
    """Columns and the standard deviations of their coefficients.

    Columns of one block are there together or not at all: without a mass, a body has no moments.
    """

    index: NDArray[np.int64]  # (c,)
    deviation: FloatArray  # (c,)
    positive: NDArray[np.bool_]  # (c,) coefficients that cannot be negative
    block: NDArray[np.int64] = field(default_factory=lambda: _NO_BLOCKS)  # (c,) rising, or one each

    def __post_init__(self) -> None:
        if self.block is _NO_BLOCKS:
            object.__setattr__(self, "block", np.arange(self.index.size))

    @classmethod
    def free(cls, index: NDArray[np.int64], deviation: FloatArray) -> Prior:
        """Return columns whose coefficients may have either sign."""
        return cls(index, deviation, np.zeros(index.size, dtype=bool))

    def of(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Prior:
        """Return some of the columns."""
        return Prior(self.index[rows], self.deviation[rows], self.positive[rows], self.block[rows])

    def beside(self, wrong: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mark the columns (c,) of blocks that have a coefficient of the wrong sign."""
        return np.isin(self.block, self.block[wrong])


@dataclass(frozen=True)
class Posterior:
    """Coefficients of nuisance columns, then of the set's."""

    index: NDArray[np.int64]  # (m,)
    mean: FloatArray  # (m,)
    covariance: FloatArray  # (m, m)


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
        self._lower = np.linalg.cholesky(inner)
        half = solve_triangular(self._lower, s[:, None] * G[at], lower=True)
        self.gram = G - half.T @ half
        b = solve_triangular(self._lower, s * product[at], lower=True)
        self.product = product - half.T @ b

    def gain(self, prior: Prior) -> float:
        """Return the log evidence of a set of columns against none.

        Columns whose coefficient would need the other sign are left out.
        """
        return self._factor(prior).gain

    def _factor(self, prior: Prior) -> _Factor:
        while True:
            at, a = prior.index, prior.deviation
            M = a[:, None] * self.gram[at[:, None], at] * a
            M.flat[:: at.size + 1] += 1.0 + _RIDGE
            lower = np.linalg.cholesky(M)
            z = _solved(lower, a * self.product[at])
            mean = _solved(lower, z, trans=1)
            wrong = prior.positive & (mean < 0)
            if not wrong.any():
                return _Factor(prior, lower, z)
            prior = prior.of(~prior.beside(wrong))

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

    def gains(self, base: Prior, more: Sequence[Prior]) -> FloatArray:
        """Return the log evidence of a set of columns with each of several others, (len(more),).

        The set is factorised once, and what each of the others adds is a Schur complement.
        """
        return self._gains(self._factor(base), base, more)

    def _gains(self, known: _Factor, base: Prior, more: Sequence[Prior]) -> FloatArray:
        result = np.full(len(more), known.gain)
        size = np.array([prior.index.size for prior in more])
        for count in np.unique(size[size > 0]):
            places = np.flatnonzero(size == count)
            some = [more[k] for k in places.tolist()]
            result[places], wrong, others = self._added(known, some)
            for k in np.flatnonzero(others).tolist():  # columns of the set have to be left out
                result[places[k]] = self.gain(joined(base, some[k]))
            own = np.flatnonzero(wrong.any(axis=1) & ~others)
            result[places[own]] = known.gain  # of one block nothing is left
            rest = [k for k in own.tolist() if some[k].block[0] != some[k].block[-1]]
            if rest:
                fewer = [some[k].of(~some[k].beside(wrong[k])) for k in rest]
                result[places[rest]] = self._gains(known, base, fewer)
        return result

    def _added(
        self, known: _Factor, more: Sequence[Prior]
    ) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return what holds with each of p priors of c columns.

        Returns:
            The evidence (p,), which of their columns have the wrong sign (p, c), and whether
            columns of the set have it (p,).
        """
        at, a = known.prior.index, known.prior.deviation
        index = np.stack([prior.index for prior in more])  # (p, c)
        scale = np.stack([prior.deviation for prior in more])
        positive = np.stack([prior.positive for prior in more])
        across = a[:, None, None] * self.gram[at[:, None, None], index] * scale  # (b, p, c)
        W = _solved(known.lower, across.reshape(at.size, index.size)).reshape(across.shape)
        own = scale[:, :, None] * self.gram[index[:, :, None], index[:, None, :]]
        unit = (1.0 + _RIDGE) * np.eye(index.shape[1])
        S = own * scale[:, None, :] - np.einsum("bpc,bpd->pcd", W, W) + unit
        r = scale * self.product[index] - np.einsum("bpc,b->pc", W, known.z)
        mean = np.linalg.solve(S, r[:, :, None])[:, :, 0]
        gain = known.gain + 0.5 * np.sum(r * mean, axis=1) - 0.5 * np.linalg.slogdet(S)[1]
        before = _solved(known.lower, known.z[:, None] - np.einsum("bpc,pc->bp", W, mean), trans=1)
        wrong = positive & (mean < 0)
        return gain, wrong, np.any(known.prior.positive[:, None] & (before < 0), axis=0)

    def posterior(self, prior: Prior) -> Posterior:
        """Return the coefficients of nuisance and set together."""
        return posterior(self.products, self.nuisance, prior)

    def at_limit(self, fitted: Posterior) -> FloatArray:
        """Return the coefficients of the nuisance (c,) that a fit has at their limit; NaN else."""
        limit = REACH * self.nuisance.deviation
        mean = fitted.mean[: limit.size]
        there = (np.abs(mean) >= (1 - _RIDGE) * limit) & (limit > 0)
        return np.where(there, mean, np.nan)


def posterior(products: NormalEquations, nuisance: Prior, prior: Prior) -> Posterior:
    """Return the coefficients of nuisance columns and a set, given sums over any rows.

    Nuisance parameters stay inside `REACH` deviations: where thousands of rows outvote a prior, a
    posterior would otherwise accept what no tolerance allows. Coefficients that cannot be negative
    are zero where they would be, with all of their block.
    """
    both = joined(nuisance, prior)
    s, count = both.deviation, nuisance.index.size
    M = s[:, None] * products.gram[np.ix_(both.index, both.index)] * s
    M.flat[:: s.size + 1] += 1.0 + _RIDGE
    c = s * products.product[both.index]
    high = np.where(np.arange(s.size) < count, REACH, np.inf)
    low = np.where(both.positive, 0.0, -high)
    x, free = np.zeros(s.size), np.ones(s.size, dtype=bool)
    while True:
        factor = cho_factor(M[np.ix_(free, free)])
        found = cho_solve(factor, c[free] - M[np.ix_(free, ~free)] @ x[~free])
        x[free] = np.clip(found, low[free], high[free])
        outside = np.zeros_like(free)
        outside[free] = x[free] != found
        if not outside.any():
            break
        absent = both.beside(outside & both.positive)  # of a body without mass
        x[absent] = 0.0
        free &= ~(outside | absent)
    covariance = np.zeros((s.size, s.size))
    covariance[np.ix_(free, free)] = cho_solve(factor, np.eye(int(free.sum())))
    return Posterior(both.index, s * x, s[:, None] * covariance * s)


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
    )
