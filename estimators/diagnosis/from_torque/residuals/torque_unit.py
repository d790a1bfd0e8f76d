"""Unit of torques: are they in N m, by what motion and arm make of them?"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.mistakes import Mistake, RowSample, without_friction
from estimators.diagnosis.settings.residuals import MISTAKES, PLAUSIBILITY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import FloatArray


def other_unit(observed: Observations) -> Mistake | None:
    """Return the unit that torques may be in that follow the motion by another order of size.

    All torques together are judged more strictly than one, since a sensor may be wrong, and a
    friction known badly.
    """
    scale = dict(_scales(observed))
    wrong = [
        j for j, factor in scale.items() if not 1 / PLAUSIBILITY.scale < factor < PLAUSIBILITY.scale
    ]
    usual = float(np.exp(np.mean(np.log(list(scale.values()))))) if len(scale) > 1 else 1.0
    if not 1 / PLAUSIBILITY.scale_of_all < usual < PLAUSIBILITY.scale_of_all:
        return Mistake(
            f"the torques are {usual:.3g} times what motion and arm make of them; expected N m; "
            f"are they in {_unit_of(usual)}, or is it another robot?",
            _divided(np.full(observed.n, usual)),
        )
    if wrong:
        j = wrong[0]
        return Mistake(
            f"torque_{j + 1} is {scale[j]:.3g} times what its motion makes of it; expected N m; is "
            f"it in {_unit_of(scale[j])}?",
            _divided(np.where(np.arange(observed.n) == j, scale[j], 1.0)),
        )
    return None


def _divided(factors: FloatArray) -> Callable[[RowSample], RowSample]:
    return lambda sample: sample.torques(np.diag(1.0 / factors))


def _unit_of(factor: float) -> str:
    """Return the units in which a torque would be as many times larger, or smaller, than in N m."""
    return "N mm or mA" if factor > 1 else "kN m or A"


def _scales(observed: Observations) -> Iterator[tuple[int, float]]:
    """Yield joint (0-based) and recorded over simulated torque, where one is like the other.

    Friction of any size may be added, or be all that is recorded of a gear that holds its load:
    where what is beyond it is of the usual size, or is none, nothing is another unit. Nor is it
    where a torque varies by less than what it should be in all: a joint that turned one way, under
    a load that hardly changed, shows little but its errors.
    """
    for j in range(observed.n):
        use = observed.moving[:, j]
        if use.sum() < MISTAKES.least_moving:
            continue
        torques = observed.measured[use, j], observed.simulated[use, j]
        y, s = (torque - torque.mean() for torque in torques)
        if not _alike(y, s):
            continue
        told = [abs(float(y @ s)) / float(s @ s)]
        v = observed.slow.velocity[use, j]
        rest, expected = without_friction(y, v), without_friction(s, v)
        if expected @ expected > PLAUSIBILITY.beyond_friction * (s @ s):
            if not _alike(rest, expected):
                continue
            told.append(abs(float(rest @ expected)) / float(expected @ expected))
        factor = min(told, key=lambda factor: abs(math.log(factor)))
        if factor > PLAUSIBILITY.scale and y @ y < torques[1] @ torques[1]:
            continue
        yield j, factor


def _alike(y: FloatArray, s: FloatArray) -> bool:
    """Say whether a torque (K,) follows another in all but its scale."""
    return abs(float(y @ s)) > PLAUSIBILITY.alike * float(np.linalg.norm(y) * np.linalg.norm(s)) > 0
