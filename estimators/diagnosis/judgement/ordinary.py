"""Ordinary: what the joints have that the description of a robot seldom states.

Every joint rubs, and every drive has inertia. Where a simulation gives a joint no friction at all,
Coulomb and viscous friction there are values to identify, and no finding. So is another law of
friction, or the inertia of drives, that more than half of these joints have: that is how the arm is
made. What one joint has and its siblings lack is unusual.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.selection.base_friction import BASE, rubs, without_friction
from estimators.diagnosis.settings.judgement import ORDINARY
from limo_driver.physics import Armature

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.fitting.problem import RegressionProblem


def ordinary(problem: RegressionProblem, members: Sequence[int]) -> tuple[int, ...]:
    """Return the members of a set that are ordinary at joints of unknown friction.

    Args:
        problem: What was compared.
        members: Of a set, as indices of its candidates.
    """
    bare = without_friction(problem.observed.simulation)
    of_drives = {
        member: candidate
        for member in members
        if (candidate := problem.candidates[member]).joints in {(j,) for j in bare}
        and (rubs(candidate.effect) or candidate.effect == Armature.name)
    }
    effects = [candidate.effect for candidate in of_drives.values()]
    most = ORDINARY.part * max(len(bare), ORDINARY.siblings)
    usual = {*BASE, *(effect for effect in effects if effects.count(effect) > most)}
    return tuple(member for member, item in of_drives.items() if item.effect in usual)
