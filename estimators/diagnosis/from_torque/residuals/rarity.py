"""Rarity: how seldom a joint's errors are as large over some seconds as they are in one place.

Where not all physics is known, errors are larger in some stretches than in others, and the largest
of many is no event. Over stretches of one length, their energy is that of noise whose variance is
itself drawn for each: a chi-square over another one, so that its ratio to what is usual has an F
distribution. How many degrees of freedom that variance has is read off the scatter of energies.

Source: Smyth, "Linear models and empirical Bayes methods for assessing differential expression in
microarray experiments", 2004, section 6.2.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import root_scalar
from scipy.special import polygamma
from scipy.stats import f as ratio_of_variances
from scipy.stats import norm

from estimators.diagnosis.settings.pushes import PUSHES

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_LEAST = float(np.log(np.finfo(float).tiny))


def rarity(energy: FloatArray, others: FloatArray, freedom: float) -> FloatArray:
    """Return how seldom stretches have so much energy by chance, -log of it, (S,) [nat].

    Args:
        energy: Sums of squared errors over some stretches, (S,).
        others: Those over other stretches of the same length, (R,); most of them are no events.
        freedom: Independent errors in a stretch.
    """
    upper = PUSHES.scatter
    usual, large = np.log(np.maximum(np.quantile(others, (0.5, upper)), np.finfo(float).tiny))
    scatter = ((large - usual) / norm.ppf(upper)) ** 2  # of logs, robust
    drawn = _freedom(float(scatter - polygamma(1, freedom / 2.0)))
    chance = ratio_of_variances.logsf(energy / np.exp(usual), freedom, drawn)
    return -np.maximum(chance, _LEAST)


def _freedom(scatter: float) -> float:
    """Return the degrees of freedom of a chi-square whose logarithm has such a variance."""

    def beyond(freedom: float) -> float:
        return float(polygamma(1, freedom / 2.0)) - scatter

    few, many = PUSHES.freedom
    if beyond(many) >= 0.0:
        return many
    return float(root_scalar(beyond, bracket=(few, many)).root) if beyond(few) > 0.0 else few
