"""Stiction: friction of a joint at rest beyond its dry friction, and where its fit begins.

As stiction grows, the instants at which a joint breaks away move, and where it comes to rest with
them: an error as a function of how much there is has many hollows. A fit goes down the one that it
begins in, and one that begins with little ends with too little. So each of a grid is tried first,
with less dry friction, too: a fit without stiction has raised it in its place.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.fitting.constants import (
    COULOMB,
    gain_of,
    value_in,
    with_values,
)
from estimators.diagnosis.from_motion.fitting.starts import away

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.types import FloatArray

SHAPES: Final = (1.0, 2.0)  # exponents of the fading: exponential, and as a bell
_AMOUNTS: Final = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0)  # of the dry friction, tried
_FADES: Final = (0.015, 0.02, 0.03, 0.06, 0.12)  # [rad/s] at which it fades, tried
_DRY: Final = (1.0, 0.85)  # of the fitted dry friction that is left, tried
_LEAST: Final = 0.005  # [rad, rad/s] of lag that a joint of no dry friction is taken to have


def stiction_begun_at(
    parts: Sequence[LoadedJoint], row: FloatArray, shape: float
) -> Mapping[str, float]:
    """Return how much stiction to start a fit from, and where it fades: the nearest of those tried.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint without it.
        shape: Exponent of the fading.

    Returns:
        Constants by name, dry friction among them.
    """
    dry = max(value_in(row, COULOMB), _LEAST * value_in(row, gain_of(row)))
    tried = [
        {"stribeck": share * dry, "v_s": pace, COULOMB: left * value_in(row, COULOMB)}
        for share, pace, left in product(_AMOUNTS, _FADES, _DRY)
    ]
    base = with_values(row, {"delta": shape})
    return tried[int(np.argmin([away(parts, with_values(base, one)) for one in tried]))]
