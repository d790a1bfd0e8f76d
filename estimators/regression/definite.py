"""Symmetric positive matrices: rank, root and inverse that stay positive under rounding.

Sums of products make a matrix that is positive; rounding makes one that is so nearly. Directions
that the data do not show get eigenvalues of either sign, of the size that the sums of a processor
happen to leave. An inverse takes that for knowledge, and the root of its diagonal for that of a
number below zero. So no such matrix is inverted as it is:

* Rows and columns are scaled to a diagonal of ones, since units say nothing of what is shown.
* Directions count as shown from `SHOWN` of that matrix' largest eigenvalue on. Rounding leaves
  1e-15 to 1e-14 of it, so that processors agree on every eigenvalue there to a ten-thousandth, and
  on the rank. Of other directions the data say nothing: a prior does, or nobody.
* What comes out is a root R, and a covariance Rᵀ R is symmetric and positive however it is rounded.

Where a prior is known to show every direction, Cholesky's factor will do, a hundred times as fast:
of a matrix whose diagonal is larger by more than rounding may take off.

Source: Golub and Van Loan, "Matrix Computations", 2013, sec. 5.4 and 5.5 (rank); van der Sluis,
"Condition numbers and equilibration of matrices", Numerische Mathematik 1969 (scaling).

Ties: of explanations whose evidence differs by rounding alone, the first one counts.

Two sets of columns may be one and the same in other words, as a load and a heavier last link are,
and a member that brings nothing leaves a set as likely as it was. Which of two such sums comes out
larger is up to the last bit, and so to the processor. So what is not clearly more is no more.

Jackknife: how far fits that each leave a part of the data out disagree.

V = (F - 1)/F Σ_f (phi_f - mean)(phi_f - mean)ᵀ,

a covariance that asks no model of the errors: what a wrong model pulls the parameters to changes
with the motion, and so shows.

Source: Shao and Tu, "The Jackknife and Bootstrap", 1995, sec. 2.3; Wu, "Jackknife, bootstrap and
other resampling methods in regression analysis", Annals of Statistics 1986.

Factors of sets of columns, less those whose coefficients would be what they cannot.

A search compares sets by the hundred thousand, and each is a system of ten to fifty unknowns: calls
from Python cost more than its arithmetic, so what is asked of many is compiled as a whole.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from scipy.linalg import solve_triangular

from limo_driver.runtime.compiled import compiled
from limo_driver.types import BoolArray, FloatArray, IntArray

SHOWN: Final = 1e-10  # of the largest eigenvalue; columns of a condition number up to 1e5
ROUNDING: Final = float(np.finfo(np.float64).eps)  # of the diagonal, by each row of a matrix
_APART: Final = 1e-6  # part of an unknown in directions that are not shown, which is no rounding
ALIKE: Final = 1e-6  # [nat], a difference that nobody could tell; sums of 1e6 nat are as exact
_OF_LARGE: Final = 1e-9  # the same of larger values

_Item = TypeVar("_Item")


@dataclass(frozen=True)
class SymmetricSpectrum:
    """Eigenvalues of a symmetric matrix whose diagonal is scaled to ones, the largest first."""

    scale: FloatArray  # (k,) of rows and columns; 0 where the diagonal is
    values: FloatArray  # (k,)
    vectors: FloatArray  # (k, k), one a column
    rank: int  # how many directions are shown, the first ones

    @classmethod
    def of(cls, matrix: FloatArray, diagonal: FloatArray | None = None) -> SymmetricSpectrum:
        """Take a matrix apart.

        Args:
            matrix: Positive but for rounding, (k, k).
            diagonal: What is scaled to ones, (k,); by default the matrix' own.
        """
        size = np.maximum(np.diag(matrix) if diagonal is None else diagonal, 0.0)
        scale = _divided(np.ones_like(size), np.sqrt(size))
        values, vectors = np.linalg.eigh(matrix * np.outer(scale, scale))
        rank = int((values > SHOWN * max(values.max(initial=0.0), 0.0)).sum())
        return cls(scale, values[::-1], vectors[:, ::-1], rank)

    @property
    def condition(self) -> float:
        """Condition number of the columns whose Gram matrix it is, each scaled to one norm.

        Infinite where a direction is not shown.
        """
        if self.rank < self.values.size:
            return np.inf
        return float(np.sqrt(self.values[0] / self.values[-1]))

    @property
    def shown(self) -> BoolArray:
        """Mark the unknowns (k,) that have no part in directions that are not shown."""
        return np.linalg.norm(self.vectors[:, self.rank :], axis=1) < _APART

    def inverse(self) -> FloatArray:
        """Return R (rank, k), with Rᵀ R the inverse in directions that are shown, 0 in others."""
        some = slice(self.rank)
        return self.vectors[:, some].T * self.scale / np.sqrt(self.values[some, None])

    def deviation(self) -> FloatArray:
        """Return roots of the diagonal of the inverse, (k,); infinite for unknowns not shown."""
        return np.where(self.shown, np.linalg.norm(self.inverse(), axis=0), np.inf)


def root_of(matrix: FloatArray) -> FloatArray:
    """Return R (k, k), with Rᵀ R a matrix (k, k) that is positive but for rounding."""
    found = SymmetricSpectrum.of(matrix)
    values = np.sqrt(np.maximum(found.values, 0.0))
    return values[:, None] * found.vectors.T * _divided(np.ones_like(found.scale), found.scale)


def lower_of(matrix: FloatArray) -> FloatArray:
    """Return L (..., k, k), with L Lᵀ a matrix that a prior makes positive in every direction."""
    larger = np.array(matrix)
    diagonal = np.einsum("...ii->...i", larger)
    diagonal *= 1.0 + ROUNDING * matrix.shape[-1]
    return np.asarray(np.linalg.cholesky(larger), dtype=np.float64)


def inverse_root(matrix: FloatArray) -> FloatArray:
    """Return R (k, k), lower triangular, with Rᵀ R the inverse of such a matrix (k, k)."""
    return solve_triangular(lower_of(matrix), np.eye(len(matrix)), lower=True)


@dataclass(frozen=True)
class RegularisedInverse:
    """Inverse of a Gram matrix of data beside a prior, (A + Fᵀ F)⁻¹ = Rᵀ R.

    In directions that the data do not show, it is the prior's alone.
    """

    prior: FloatArray  # F, (m, k)
    root: FloatArray  # R, (k, k)
    of_data: FloatArray  # (k, k), R⁻ᵀ of what data show, 0 of what they do not
    log_determinant: float  # of the inverse

    @classmethod
    def of(cls, gram: FloatArray, prior: FloatArray) -> RegularisedInverse:
        """Invert a Gram matrix (k, k) beside a prior.

        Args:
            gram: Of data, A.
            prior: Root of the precision before any data, F (m, k), of rank k.
        """
        data = SymmetricSpectrum.of(gram, np.diag(gram) + np.sum(prior**2, axis=0))
        rows = np.zeros_like(gram)
        np.fill_diagonal(rows[: data.rank], np.sqrt(data.values[: data.rank]))
        both = np.concatenate([rows, (prior * data.scale) @ data.vectors])
        upper = np.asarray(np.linalg.qr(both, mode="r"))
        half = solve_triangular(upper.T, np.eye(len(gram)), lower=True)
        basis, shown = data.vectors.T * data.scale, slice(data.rank)
        volume = np.log(np.abs(np.diag(half))).sum() + np.log(data.scale).sum()
        return cls(prior, half @ basis, half[:, shown] @ basis[shown], 2.0 * float(volume))

    @property
    def matrix(self) -> FloatArray:
        """The inverse itself, (k, k)."""
        return self.root.T @ self.root

    @property
    def shown(self) -> BoolArray:
        """Mark the unknowns (k,) of whose variance the prior makes up less than half."""
        of_prior = np.sum((self.prior @ self.matrix) ** 2, axis=0)
        return of_prior < 0.5 * np.sum(self.root**2, axis=0)

    def estimate(self, products: FloatArray) -> FloatArray:
        """Return the unknowns (..., k) by which data, of products (..., k), are explained.

        Products in directions that the data do not show are rounding, and count for nothing.
        """
        return products @ self.of_data.T @ self.root

    def spread(self, root: FloatArray) -> FloatArray:
        """Return D (m + f, k), with Dᵀ D the covariance of estimates.

        Args:
            root: Of the covariance of the products, S (f, k) with Sᵀ S.
        """
        return np.concatenate([self.estimate(root), self.prior @ self.matrix])


def _divided(some: FloatArray, by: FloatArray) -> FloatArray:
    """Divide, with zero for what is divided by zero."""
    return np.divide(some, by, out=np.zeros_like(some), where=by > 0)


def is_more(value: float, than: float) -> bool:
    """Say whether a value is larger than another by more than rounding."""
    alike = max(ALIKE, _OF_LARGE * min(abs(value), abs(than)))  # either may be infinite
    return value > than and value - than > alike


def best_first(values: FloatArray) -> IntArray:
    """Return the places of values (k,), the largest first, and of those alike the first one."""
    order = np.argsort(-values, kind="stable")
    falling = np.nan_to_num(values[order])  # what is out of the question is -inf
    apart = falling[:-1] - falling[1:] > np.maximum(ALIKE, _OF_LARGE * np.abs(falling[1:]))
    step = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(apart)])[: order.size]
    return order[np.lexsort((order, step))]


def ranked(items: Iterable[_Item], value: Callable[[_Item], float]) -> list[_Item]:
    """Return items by their values, the best first; those alike stay in their order."""
    every = list(items)
    return [every[k] for k in best_first(np.array([value(item) for item in every], dtype=float))]


def first_best(items: Iterable[_Item], value: Callable[[_Item], float]) -> _Item:
    """Return the item of the largest value, and of those alike the first one."""
    return ranked(items, value)[0]


def jackknife(fits: Sequence[FloatArray]) -> FloatArray:
    """Return D (F, p), with Dᵀ D the covariance of parameters (p,) fitted without each of F parts.

    The norms of its columns are the parameters' standard deviations.
    """
    off = np.asarray(fits, dtype=np.float64) - fits[0]  # exactly zero where all agree
    return np.sqrt((len(off) - 1) / len(off)) * (off - off.mean(axis=0))


RIDGE = 1e-9  # beside the 1 of a prior


@compiled(reads=("index", "deviation", "positive", "most", "block"))
def of_right_signs(
    gram: FloatArray,
    product: FloatArray,
    index: IntArray,
    deviation: FloatArray,
    positive: BoolArray,
    most: FloatArray,
    block: IntArray,
    rows: IntArray,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Leave blocks with a coefficient that cannot be out of rows of a table, round after round.

    Returns:
        The rows that are left (b,), their factor (b, b), and its z (b,).
    """
    while True:
        at, s = index[rows], deviation[rows]
        M = np.empty((rows.size, rows.size))
        for i in range(rows.size):
            for j in range(rows.size):
                M[i, j] = s[i] * gram[at[i], at[j]] * s[j]
            M[i, i] = (1.0 + ROUNDING * rows.size) * M[i, i] + 1.0 + RIDGE
        lower = np.linalg.cholesky(M)
        z = _forward(lower, s * product[at])
        rest = _without_wrong(rows, positive, most, block, _backward(lower, z))
        if rest.size == rows.size:
            return rows, lower, z
        rows = rest


@compiled(reads=("index", "deviation", "positive", "most", "block", "start"))
def gains_beside(
    base: IntArray,
    lower: FloatArray,
    z: FloatArray,
    across: FloatArray,
    back: FloatArray,
    gram: FloatArray,
    product: FloatArray,
    index: IntArray,
    deviation: FloatArray,
    positive: BoolArray,
    most: FloatArray,
    block: IntArray,
    start: IntArray,
    some: IntArray,
) -> FloatArray:
    """Return the log evidence of a set with each of p others beside it.

    Args:
        base: Rows of the table (b,) that are the set, less those that cannot be.
        lower: Their factor (b, b).
        z: Of that, (b,).
        across: L⁻¹ A G, (b, c).
        back: L⁻ᵀ of z, then of `across`, (b', 1 + c), at its columns that must be positive.
        gram: Products of all columns (c, c).
        product: Products of all columns (c,).
        index: Columns of the sets of a table, one set behind the other.
        deviation: Of each.
        positive: Whether it must be.
        most: What it may be [deviations]; infinite unless it must be positive.
        block: To which each belongs.
        start: Where each set begins in the table.
        some: Which sets are asked about (p,).
    """
    known, top = _gain(lower, z), most[base][positive[base]]
    left = product - z @ across
    gains = np.full(some.size, known)
    for k in range(some.size):
        rows = np.arange(start[some[k]], start[some[k] + 1])
        while rows.size:
            at, s = index[rows], deviation[rows]
            M = np.empty((rows.size, rows.size))
            for i in range(rows.size):
                for j in range(i + 1):
                    inner = gram[at[i], at[j]]
                    for b in range(base.size):
                        inner -= across[b, at[i]] * across[b, at[j]]
                    M[i, j] = M[j, i] = s[i] * inner * s[j]
                M[i, i] = (1.0 + ROUNDING * rows.size) * max(M[i, i], 0.0) + 1.0 + RIDGE
            own = np.linalg.cholesky(M)
            added = _forward(own, s * left[at])
            mean = _backward(own, added)
            others = False
            for i in range(back.shape[0]):
                value = back[i, 0]
                for j in range(rows.size):
                    value -= back[i, 1 + at[j]] * s[j] * mean[j]
                others |= value < 0 or value > top[i]
            if others:  # columns of the set have to be left out
                _, whole, z_whole = of_right_signs(
                    gram, product, index, deviation, positive, most, block, np.append(base, rows)
                )
                gains[k] = _gain(whole, z_whole)
                break
            rest = _without_wrong(rows, positive, most, block, mean)
            if rest.size == rows.size:
                gains[k] = known + _gain(own, added)
                break
            rows = rest
    return gains


@compiled()
def _gain(lower: FloatArray, z: FloatArray) -> float:
    """Return the log evidence of a factorised set against none."""
    gain = 0.0
    for i in range(z.size):
        gain += 0.5 * z[i] * z[i] - np.log(lower[i, i])
    return gain


@compiled()
def _without_wrong(
    rows: IntArray, positive: BoolArray, most: FloatArray, block: IntArray, mean: FloatArray
) -> IntArray:
    """Return the rows whose blocks have no coefficient that cannot be."""
    right = np.ones(rows.size, dtype=np.bool_)
    for i in range(rows.size):
        if positive[rows[i]] and (mean[i] < 0 or mean[i] > most[rows[i]]):
            for j in range(rows.size):
                right[j] &= block[rows[j]] != block[rows[i]]
    return rows[right]


@compiled()
def _forward(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Solve L x = right."""
    x = right.copy()
    for i in range(x.size):
        for j in range(i):
            x[i] -= lower[i, j] * x[j]
        x[i] /= lower[i, i]
    return x


@compiled()
def _backward(lower: FloatArray, right: FloatArray) -> FloatArray:
    """Solve Lᵀ x = right."""
    x = right.copy()
    for i in range(x.size - 1, -1, -1):
        x[i] /= lower[i, i]
        for j in range(i):
            x[j] -= lower[i, j] * x[i]
    return x
