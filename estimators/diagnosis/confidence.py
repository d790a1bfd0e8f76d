"""Confidence: how sure a name is, from its lead, its size and what is left.

The weights are those of a logistic regression on concealed cases that nothing is reported of, by
`benchmarks/diagnosis_calibration.py`; `benchmarks/diagnosis.py` measures on others how well they
hold.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_BIAS, _LEAD, _MATERIAL, _FORETOLD, _RIVALS = -0.5, 0.6, 0.8, -1.0, -0.3
_HIGHEST = 0.99
OF_UNKNOWN = 0.9  # part of the cases in which what nothing explained was unknown physics there
OF_CONTACT = 0.95  # and in which what looked like a push was one


@dataclass(frozen=True)
class Signs:
    """What the confidence of a name is made of."""

    lead: float  # evidence over the next explanation [nat]
    material: float  # held-out error that it removes [noise floors]
    foretold: float  # error left on that joint that could still be foretold [noise floors]
    rivals: int  # number of effects that cannot be told apart from it


def confidence_of(signs: Signs) -> float:
    """Return the probability that a finding names the right effect at the right joint."""
    score = (
        _BIAS
        + _LEAD * math.log1p(max(signs.lead, 0.0))
        + _MATERIAL * math.log(max(signs.material, 1e-3))
        + _FORETOLD * signs.foretold
        + _RIVALS * signs.rivals
    )
    return min(_HIGHEST, 1.0 / (1.0 + math.exp(-score)))
