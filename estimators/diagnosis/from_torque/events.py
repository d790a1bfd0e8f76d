"""Events, sought in turn with effects beside which they show: pushes, jolts, impacts of play.

An event is no physics of the arm, so nothing is fitted to its rows. They are sought in what a set
of effects leaves, since effects that are not out look like pushes themselves. What larger errors
hid shows once the whole set is out, and what they feigned is gone then: its rows count again.

Reconsidering: what is found around a judged set, in time with it, and beyond tolerances.

Each may take the place of the set only where it predicts motion held out no worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from estimators.diagnosis.from_torque.fitting.lateness import with_torque_delay
from estimators.diagnosis.from_torque.fitting.settling import (
    linearisation_is_poor,
    prune_refine_simplify,
    pruned,
    solve_around,
    suspects,
)
from estimators.diagnosis.from_torque.fitting.solving import solve, with_hypotheses
from estimators.diagnosis.from_torque.hypotheses.catalogue import every
from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
from estimators.diagnosis.from_torque.judgement.judgement import harmed, worse_at
from estimators.diagnosis.from_torque.residuals.jolts import Impact, Jolt, holds, impacts, jolts
from estimators.diagnosis.from_torque.residuals.jolts import impacts_note as note_of_play
from estimators.diagnosis.from_torque.residuals.jolts import jolts_note as note
from estimators.diagnosis.from_torque.residuals.pushes import Push, covered, overlap, pushes
from estimators.diagnosis.settings.fitting import SOLVING
from estimators.diagnosis.settings.judgement import ROUNDS
from limo_driver.physics import TimeDelay

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem, Solution
    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.stages import Budget, Progress
    from limo_driver.types import FloatArray

Event: TypeAlias = "Push | Jolt | Impact"


@dataclass(frozen=True)
class Events:
    """Stretches that nothing is fitted to, and those that only looked so until all was out."""

    seen: tuple[Event, ...]
    gone: tuple[Event, ...]

    @property
    def pushes(self) -> tuple[Push, ...]:
        """Stretches in which something pushed."""
        return tuple(event for event in self.seen if isinstance(event, Push))

    def notes(self, recordings: int) -> Iterator[str]:
        """Say what is no finding, of so many recordings: jolts, impacts, and pushes explained."""
        if found := [event for event in self.seen if isinstance(event, Jolt)]:
            yield note(found, recordings)
        if caught := [event for event in self.seen if isinstance(event, Impact)]:
            yield note_of_play(caught, recordings)
        if times := [
            f"{event.start:.1f} to {event.end:.1f} s"
            for event in self.gone
            if isinstance(event, Push)
        ]:
            yield (
                f"What looked like a push at first ({'; '.join(times)}) is explained by what was "
                "found since, and is no finding."
            )


def apart_from_events(
    problem: RegressionProblem, progress: Progress, budget: Budget
) -> tuple[JudgedSet, Events]:
    """Return the set that is found beside events, fitted to none of their rows, and those."""
    solution = solve(problem, progress)
    known = _events(
        solution.problem, solution.problem.under(solution), solution.problem.left(solution.fitted)
    )
    if known:
        solution = _without(solution.problem, known, progress)
    found = budget.within(
        "values that are not linear, and simpler laws",
        lambda: prune_refine_simplify(solution, progress),
        None,
    )
    solution = found or pruned(solution)
    judged, seen = _round(solution, progress, budget)
    for _ in range(SOLVING.rounds):
        hidden = tuple(event for event in seen if not _among(event, known))
        if not hidden:
            break
        again = partial(_once_more, solution.problem, (*known, *hidden), progress, budget)
        more = budget.within("events that larger errors hid", again, None)
        if more is None:
            break
        known, (solution, judged, seen) = (*known, *hidden), more
    sought = known
    while (held := tuple(event for event in known if _among(event, seen))) != known:
        again = partial(_once_more, problem, held, progress, budget)
        more = budget.within("rows on which effects feigned an event", again, None)
        if more is None:
            break
        known, (_, judged, seen) = held, more
    real = tuple(event for event in seen if _among(event, known))
    return judged, Events(real, tuple(event for event in sought if not _among(event, real)))


def _once_more(
    problem: RegressionProblem, known: tuple[Event, ...], progress: Progress, budget: Budget
) -> tuple[Solution, JudgedSet, tuple[Event, ...]]:
    """Solve, settle and judge without the rows of events; return the settled set with both."""
    solution = prune_refine_simplify(_without(problem, known, progress), progress)
    return solution, *_round(solution, progress, budget)


def _without(problem: RegressionProblem, known: Sequence[Event], progress: Progress) -> Solution:
    """Leave the rows of events out, and solve again."""
    return solve(problem.undisturbed(covered(problem.observed, known)), progress)


def _round(
    solution: Solution, progress: Progress, budget: Budget
) -> tuple[JudgedSet, tuple[Event, ...]]:
    """Judge a settled set; return it with the events that are seen in what it leaves."""
    progress("proving on held-out motion", 0.8)
    judged = around(JudgedSet.of(solution), progress, budget)
    judged = budget.within("a delay of all of it", lambda: in_time(judged, progress), judged)
    judged = budget.within(
        "laws that joints seldom follow", lambda: with_seldom_laws(judged, progress), judged
    )
    return judged, _events(solution.problem, judged.beside, judged.proven)


def _events(problem: RegressionProblem, fit: Observations, left: FloatArray) -> tuple[Event, ...]:
    """Return the events in what a fit leaves, (K, n) [N m], with the simulation of it."""
    held, observed = holds(fit), problem.observed  # a fit has other widths of signs: other rests
    pushed = (*(push for push in pushes(observed, left) if not _among(push, held)), *held)
    found = (*pushed, *jolts(observed, left, pushed))
    caught = impacts(observed, left, found)
    return (*(event for event in found if not _among(event, caught)), *caught)


def _among(event: Event, others: Sequence[Event]) -> bool:
    return any(overlap(event, other) for other in others)


def around(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
    """Return the best set around one, if there is time to look for it."""
    return budget.within(
        "other sets around the one that was found", lambda: _best(judged, progress), judged
    )


def _best(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found around a set, where that may differ and predicts no worse."""
    solution, predictable = judged.solution, judged.remaining.clearly_predictable
    several = len(solution.members) >= ROUNDS.several
    if not (several or predictable.any()) or not linearisation_is_poor(solution):
        return judged
    return judged.or_better(JudgedSet.of(solve_around(solution, progress)))


def in_time(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found around a lateness of all of it, where that predicts no worse.

    It counts if it names a delay, leaves less unknown than before, or serves where that does not.
    """
    late = with_torque_delay(judged.solution, judged.unknown)
    if late is None:
        return judged
    again = JudgedSet.of(solve_around(late, progress))
    # times that are tried lie far apart: what stood for the difference to the true one goes, or is
    # another effect, but there is no more than before
    nearer = JudgedSet.of(solve_around(again.solution, progress))
    larger = len(nearer.solution.members) > len(again.solution.members)
    if not larger and not worse_at(nearer.problem, nearer.proven, again.proven, again.remaining):
        again = nearer
    found = {effect for effect, _ in again.places(again.named)}
    improves_held_out = again.improves_held_out and not judged.improves_held_out
    if (
        not improves_held_out
        and TimeDelay.name not in found
        and not set(again.unknown) < set(judged.unknown)
    ):
        return judged
    return judged.or_better(again)


def with_seldom_laws(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found among laws that seldom hold, where that leaves less unexplained."""
    if not judged.unexplained:
        return judged
    problem = with_hypotheses(judged.problem, every(judged.problem.observed, seldom=True))
    again = JudgedSet.of(prune_refine_simplify(solve(problem, progress), progress))
    laws = (again.problem.candidates[member].hypothesis for member in again.named)
    found = any(law is not None and law.seldom for law in laws)
    return judged.or_better(again) if found and again.unexplained < judged.unexplained else judged


def beyond_tolerances(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
    """Return the findings with suspicious values held as stated, where that explains more.

    While sets compete, thousands of rows outvote tolerances, and the effect of a wrong value is
    ascribed to nuisance parameters. Fitted values stay within their limits, and their effect beyond
    those is unknown, or too small to be seen. Held as it is stated, such a value has to be a
    finding, and may bring no other name with it.
    """
    problem, solution = judged.problem, judged.solution
    held = suspects(solution, judged.unknown)
    if not held or harmed(problem, judged.proven, judged.remaining):
        return judged
    problem = (problem.first or problem).as_stated(problem.nuisance.of(held))
    again = JudgedSet.of(prune_refine_simplify(solve(problem, progress), progress))
    again = around(again, progress, budget)
    found = again.places(again.findings)
    if not found <= judged.places(solution.members) | held:
        return judged
    fewer = set(again.unknown) < set(judged.unknown)
    wrong = set(again.unknown) == set(judged.unknown) and found & held
    if fewer or (wrong and not worse_at(problem, again.proven, judged.proven, judged.remaining)):
        return again
    return judged
