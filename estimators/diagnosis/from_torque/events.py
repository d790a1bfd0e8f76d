"""Events, sought in turn with effects beside which they show: pushes, jolts, impacts of play.

An event is no physics of the arm, so nothing is fitted to its rows. They are sought in what a set
of effects leaves, since effects that are not out look like pushes themselves. What larger errors
hid shows once the whole set is out, and what they feigned is gone then: its rows count again.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

from estimators.diagnosis.from_torque.fitting.settling import pruned, settled
from estimators.diagnosis.from_torque.fitting.solving import solve
from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
from estimators.diagnosis.from_torque.reconsidering import around, in_time
from estimators.diagnosis.from_torque.residuals.impacts import Impact, impacts
from estimators.diagnosis.from_torque.residuals.impacts import note as note_of_play
from estimators.diagnosis.from_torque.residuals.jolts import Jolt, jolts, note
from estimators.diagnosis.from_torque.residuals.pushes import Push, covered, overlap, pushes
from estimators.diagnosis.settings.pushes import ROUNDS

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
    first = problem
    problem, solution = solve(problem, progress)
    known = _events(problem.observed, problem.left(solution.fitted))
    if known:
        problem, solution = _without(problem, known, progress)
    found = budget.within(
        "values that are not linear, and simpler laws",
        lambda: settled(problem, solution, progress),
        None,
    )
    problem, solution = found or (problem, pruned(problem, solution))
    judged, seen = _round(problem, solution, progress, budget)
    for _ in range(ROUNDS.more):
        hidden = tuple(event for event in seen if not _among(event, known))
        if not hidden:
            break
        again = partial(_once_more, problem, (*known, *hidden), progress, budget)
        more = budget.within("events that larger errors hid", again, None)
        if more is None:
            break
        known, (problem, judged, seen) = (*known, *hidden), more
    sought = known
    while (held := tuple(event for event in known if _among(event, seen))) != known:
        again = partial(_once_more, first, held, progress, budget)
        more = budget.within("rows on which effects feigned an event", again, None)
        if more is None:
            break
        known, (_, judged, seen) = held, more
    real = tuple(event for event in seen if _among(event, known))
    return judged, Events(real, tuple(event for event in sought if not _among(event, real)))


def _once_more(
    problem: RegressionProblem, known: tuple[Event, ...], progress: Progress, budget: Budget
) -> tuple[RegressionProblem, JudgedSet, tuple[Event, ...]]:
    """Solve, settle and judge without the rows of events; return the problem with both results."""
    problem, solution = settled(*_without(problem, known, progress), progress)
    return problem, *_round(problem, solution, progress, budget)


def _without(
    problem: RegressionProblem, known: Sequence[Event], progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Leave the rows of events out, and solve again."""
    return solve(problem.undisturbed(covered(problem.observed, known)), progress)


def _round(
    problem: RegressionProblem, solution: Solution, progress: Progress, budget: Budget
) -> tuple[JudgedSet, tuple[Event, ...]]:
    """Judge a settled set; return it with the events that are seen in what it leaves."""
    progress("proving on held-out motion", 0.8)
    judged = around(JudgedSet.of(problem, solution), progress, budget)
    judged = budget.within("a delay of all of it", lambda: in_time(judged, progress), judged)
    return judged, _events(problem.observed, judged.proven)


def _events(observed: Observations, left: FloatArray) -> tuple[Event, ...]:
    """Return the events in what a fit leaves, (K, n) [N m]."""
    pushed = pushes(observed, left)
    found = (*pushed, *jolts(observed, left, pushed))
    caught = impacts(observed, left, found)
    return (*(event for event in found if not _among(event, caught)), *caught)


def _among(event: Event, others: Sequence[Event]) -> bool:
    return any(overlap(event, other) for other in others)
