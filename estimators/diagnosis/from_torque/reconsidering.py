"""Reconsidering: what is found around a judged set, in time with it, and beyond tolerances.

Each may take the place of the set only where it predicts motion held out no worse.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.from_torque.fitting.lateness import made_late
from estimators.diagnosis.from_torque.fitting.settling import (
    curved,
    settled,
    settled_around,
    suspects,
)
from estimators.diagnosis.from_torque.fitting.solving import solve
from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
from estimators.diagnosis.from_torque.judgement.judgement import harmed, worse
from estimators.diagnosis.settings.pushes import ROUNDS
from limo_driver.physics import TimeDelay

if TYPE_CHECKING:
    from estimators.diagnosis.stages import Budget, Progress


def around(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
    """Return the best set around one, if there is time to look for it."""
    return budget.within(
        "other sets around the one that was found", lambda: _best(judged, progress), judged
    )


def _best(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found around a set, where that may differ and predicts no worse."""
    problem, solution = judged.problem, judged.solution
    several = len(solution.members) >= ROUNDS.several
    if not (several or judged.remaining.clearly_predictable.any()) or not curved(problem, solution):
        return judged
    return judged.or_better(JudgedSet.of(*settled_around(problem, solution, progress)))


def in_time(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found around a lateness of all of it, where that predicts no worse.

    It counts if it names a delay, leaves less unknown than before, or serves where that does not.
    """
    late = made_late(judged.problem, judged.solution, judged.unknown)
    if late is None:
        return judged
    again = JudgedSet.of(*settled_around(*late, progress))
    # times that are tried lie far apart: what stood for the difference to the true one goes, or is
    # another effect, but there is no more than before
    nearer = JudgedSet.of(*settled_around(again.problem, again.solution, progress))
    larger = len(nearer.solution.members) > len(again.solution.members)
    if not larger and not worse(nearer.problem, nearer.proven, again.proven, again.remaining):
        again = nearer
    found = {effect for effect, _ in again.places(again.named)}
    serves = again.serves and not judged.serves
    if not serves and TimeDelay.name not in found and not set(again.unknown) < set(judged.unknown):
        return judged
    return judged.or_better(again)


def beyond_tolerances(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
    """Return the findings with suspicious values held as stated, where that explains more.

    While sets compete, thousands of rows outvote tolerances, and the effect of a wrong value is
    ascribed to nuisance parameters. Fitted values stay within their limits, and their effect beyond
    those is unknown, or too small to be seen. Held as it is stated, such a value has to be a
    finding, and may bring no other name with it.
    """
    problem, solution = judged.problem, judged.solution
    held = suspects(problem, solution, judged.unknown)
    if not held or harmed(problem, judged.proven, judged.remaining):
        return judged
    problem = (problem.first or problem).as_stated(problem.nuisance.of(held))
    again = JudgedSet.of(*settled(*solve(problem, progress), progress))
    again = around(again, progress, budget)
    found = again.places(again.findings)
    if not found <= judged.places(solution.members) | held:
        return judged
    fewer = set(again.unknown) < set(judged.unknown)
    wrong = set(again.unknown) == set(judged.unknown) and found & held
    if fewer or (wrong and not worse(problem, again.proven, judged.proven, judged.remaining)):
        return again
    return judged
