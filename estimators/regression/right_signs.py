"""Factors of sets of columns, less those whose coefficients would be what they cannot.

A search compares sets by the hundred thousand, and each is a system of ten to fifty unknowns: calls
from Python cost more than its arithmetic, so what is asked of many is compiled as a whole.
"""

# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from estimators.regression.definite import ROUNDING
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

RIDGE = 1e-9  # beside the 1 of a prior


@compiled(reads=("index", "deviation", "positive", "most", "block"))
def of_right_signs(
    gram: FloatArray,
    product: FloatArray,
    index: NDArray[np.int64],
    deviation: FloatArray,
    positive: NDArray[np.bool_],
    most: FloatArray,
    block: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
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
    base: NDArray[np.int64],
    lower: FloatArray,
    z: FloatArray,
    across: FloatArray,
    back: FloatArray,
    gram: FloatArray,
    product: FloatArray,
    index: NDArray[np.int64],
    deviation: FloatArray,
    positive: NDArray[np.bool_],
    most: FloatArray,
    block: NDArray[np.int64],
    start: NDArray[np.int64],
    some: NDArray[np.int64],
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
    rows: NDArray[np.int64],
    positive: NDArray[np.bool_],
    most: FloatArray,
    block: NDArray[np.int64],
    mean: FloatArray,
) -> NDArray[np.int64]:
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
