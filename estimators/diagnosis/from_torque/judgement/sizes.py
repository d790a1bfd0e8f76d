"""Sizes: findings whose interval leaves it open whether there is anything at all.

An effect may predict better on motion held out and still be of no known size: a spring whose
stiffness may be zero, since a wrong body of the link does nearly as well. What the recordings do
not tell from nothing is no finding. Of elements that stand in for one another, as those of
presliding, what all of them take off says whether they are nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from estimators.diagnosis.from_torque.fitting.entries import found_in
from estimators.diagnosis.settings.judgement import JUDGEMENT
from limo_driver.physics import GravityDirection
from limo_driver.physics.catalogue import every_effect
from limo_driver.runtime.parameters import REAL

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.verdict import Finding, Interval
    from limo_driver.physics import Simulation


def unsure(findings: Sequence[Finding], given: Simulation) -> set[tuple[str, tuple[int, ...]]]:
    """Return effect and joints (1-based) of findings whose size may be nothing.

    Args:
        findings: With parameters and their intervals.
        given: The simulation that was compared; a wrong value differs from the one stated there.
    """
    sized_by = {effect.name: effect.sized_by for effect in every_effect()}
    return {
        (item.effect, item.joints)
        for item in findings
        if not _is_sure(item, given, sized_by.get(item.effect, ()))
    }


def _is_sure(item: Finding, given: Simulation, sized_by: tuple[str, ...]) -> bool:
    """Say whether an interval of the size is known and leaves out nothing, or what was stated."""
    stated = None
    if item.kind == "wrong_parameter":
        stated = found_in(given, item.effect, item.joints, missing=False)
    elif item.effect == GravityDirection.name:  # every simulation states where gravity points to
        x, y, z = map(float, given.model.gravity)
        stated = GravityDirection(gravity=(x, y, z))
    known = sized_by
    if stated is not None:
        known = tuple(p.name for p in stated.parameters() if p.kind == REAL)
    pairs = [
        (interval, getattr(stated, name, None))
        for name in known
        if (interval := item.parameters.get(name)) is not None and interval.ci95 is not None
    ]
    if not pairs or any(_leaves_out(interval, was) for interval, was in pairs):
        return True
    # each element of a list may be nothing for the sake of its neighbours, but hardly all of them
    several = any(np.size(interval.value) > 1 for interval, _ in pairs)
    return several and stated is None and item.signs.get("material", 0.0) >= JUDGEMENT.small


def _leaves_out(interval: Interval, was: Any) -> bool:  # noqa: ANN401  # of any parameter
    """Say whether an interval, or one of several, does not hold what was; zero if that is None."""
    ends = np.asarray(interval.ci95, dtype=float).reshape(-1, 2)
    before = np.zeros(len(ends)) if was is None else np.ravel(np.asarray(was, dtype=float))
    if before.size != len(ends):
        return True  # of another form than before
    return bool(np.any((ends[:, 0] > before) | (ends[:, 1] < before)))
