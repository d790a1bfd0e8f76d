"""Shares of predictions that motion left out confirms.

The shares g ≥ 0 of k predictions, of a sum of at most 1, minimise the squared error on all parts of
the motion, each predicted by who did not see it. They shrink by what could be luck: with the mean m
of what each part gains by the shares of the other parts, and its standard error s, by 1 - (SURE s /
m)², and to nothing where that is negative.

Source: Breiman, "Stacked regressions", Machine Learning 1996; James and Stein, "Estimation with
quadratic loss", 1961 (the part that is kept).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.optimize import nnls

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.types import FloatArray

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
