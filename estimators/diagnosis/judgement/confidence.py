"""Confidence: how sure a name is, from its lead and its size.

The weights are those of a logistic regression on 63 concealed cases that nothing is reported of (68
names, of which 65 are right), by `benchmarks/diagnosis/diagnosis_calibration.py`;
`benchmarks/diagnosis/diagnosis.py` measures on others how well they hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_WEIGHTS = (0.7, 0.25, 1.6)  # of 1, lead and size
_HIGHEST = 0.99
OF_UNKNOWN = 0.75  # part of the cases in which what nothing explained was unknown physics there
OF_CONTACT = 0.95  # and in which what looked like a push was one


@dataclass(frozen=True)
class Signs:
    """What the confidence of a name is made of."""

    lead: float  # evidence over the next explanation [nat]
    material: float  # error that it removes [noise floors]


def features(signs: Signs) -> tuple[float, float, float]:
    """Return what is weighed; the first is 1."""
    return 1.0, math.log1p(max(signs.lead, 0.0)), math.log(max(signs.material, 1e-3))


def confidence_of(signs: Signs) -> float:
    """Return the probability that a finding names the right effect at the right joint."""
    score = sum(weight * value for weight, value in zip(_WEIGHTS, features(signs), strict=True))
    return min(_HIGHEST, 1.0 / (1.0 + math.exp(-score)))
