"""Confidence: how sure a name is, from its lead, its size and what is left.

The logistic weights are set by hand, and not yet fitted; `benchmarks/diagnosis.py` measures how
well they are calibrated on concealed arms.
"""

from __future__ import annotations

import math

_BIAS, _LEAD, _MATERIAL, _FORETOLD, _RIVALS = -0.5, 0.6, 0.8, -1.0, -0.3
_HIGHEST = 0.99


def confidence_of(*, lead: float, material: float, foretold: float, rivals: int) -> float:
    """Return the probability that a finding names the right effect at the right joint.

    Args:
        lead: Evidence over the next explanation [nat].
        material: Held-out error that it removes [noise floors].
        foretold: Error left on that joint that could still be foretold [noise floors].
        rivals: Number of effects that cannot be told apart from it.
    """
    score = (
        _BIAS
        + _LEAD * math.log1p(max(lead, 0.0))
        + _MATERIAL * math.log(max(material, 1e-3))
        + _FORETOLD * foretold
        + _RIVALS * rivals
    )
    return min(_HIGHEST, 1.0 / (1.0 + math.exp(-score)))
