"""The pipeline: from recordings and a simulation to a diagnosis, one stage after the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.diagnosis.contact import contact_of
from estimators.diagnosis.fitting.contribution import left_by_tolerances
from estimators.diagnosis.fitting.intervals import with_parameters
from estimators.diagnosis.fitting.lateness import made_late
from estimators.diagnosis.fitting.problem import RegressionProblem, Solution
from estimators.diagnosis.fitting.settling import (
    curved,
    pruned,
    settled,
    settled_around,
    suspects,
)
from estimators.diagnosis.fitting.solving import solve
from estimators.diagnosis.judgement.conclusion import conclude, explanations_of, shifts_of
from estimators.diagnosis.judgement.judged_set import JudgedSet
from estimators.diagnosis.judgement.judgement import (
    harmed,
    remarks,
    trusted_gains,
    worse,
)
from estimators.diagnosis.judgement.questions import tests_of
from estimators.diagnosis.judgement.sizes import unsure
from estimators.diagnosis.residuals.mounting import as_mounted, with_mounting
from estimators.diagnosis.residuals.observations import Observations
from estimators.diagnosis.residuals.plausibility import check_plausible
from estimators.diagnosis.residuals.pushes import covered, overlap, pushes
from estimators.diagnosis.residuals.usable_joints import left_out
from estimators.diagnosis.result import Diagnosis, Traces
from estimators.diagnosis.settings.pushes import ROUNDS
from estimators.diagnosis.stages import Attempts, Budget, Progress, forward, quiet
from estimators.diagnosis.verdict import Finding, Identified
from estimators.recordings import check_different
from limo_driver.errors import RecordingError
from limo_driver.physics import TimeDelay, spoken
from limo_driver.recordings.bandwidth import BANDWIDTH

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.residuals.pushes import Push
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


def observe(
    simulation: Simulation, recordings: Sequence[Recording], bandwidth: float
) -> Observations:
    """Check that the recordings can be of the simulation's robot, and filter them."""
    if not recordings:
        raise RecordingError("no recording to diagnose")
    for recording in recordings:
        recording.check_robot(simulation.model)
    check_different(recordings)
    every = [recording.by_joint() for recording in recordings]  # one bad channel costs its joint
    observed = Observations.of(simulation, every, bandwidth)
    check_plausible(observed)
    return observed.without_torque_of(left_out(observed))


@threadpool_limits.wrap(limits=1, user_api="blas")  # more collapse on busy cores, and gain nothing
def diagnose(
    simulation: Simulation,
    recordings: Sequence[Recording],
    bandwidth: float = BANDWIDTH,
    progress: Progress = quiet,
    budget: Budget | None = None,
) -> Diagnosis:
    """Find where a simulation and recordings differ, and which physics is missing.

    Args:
        simulation: What is believed of the arm, with its tolerances.
        recordings: One or more of that arm.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].
        progress: Told the stage and the part that is done, which never goes back, and ends at 1.
        budget: Time for it; without end if not given. It keeps what there was no time for.

    Returns:
        The verdict with its evidence. Where a stage fails without which there is still a verdict,
        that says so, and `failures` has the error.

    Raises:
        RecordingError: The recordings cannot be used, are of another robot, or one is given twice.
    """
    budget = budget or Budget()
    progress = budget.watched(forward(progress))
    progress("reading motion", 0.0)
    given = observe(simulation, recordings, bandwidth)
    problem = RegressionProblem.of(as_mounted(given), progress)
    judged, pushed = _without_pushes(problem, progress, budget)
    judged = budget.within(
        "values beyond their tolerances",
        lambda: _beyond_tolerances(judged, progress, budget),
        judged,
    )
    judged, harmful = judged.harmless()
    judged = judged.beyond_ordinary()
    progress("fitting to all rows", 0.95)
    found = _told(given, judged, pushed, budget, harmful=harmful)
    progress("done", 1.0)
    return found


def _told(
    given: Observations,
    judged: JudgedSet,
    pushed: _Pushed,
    budget: Budget,
    *,
    harmful: bool,
) -> Diagnosis:
    """Fit a judged set to all rows, and return what is to be said of it.

    Args:
        given: The recordings beside the given simulation.
        judged: The set, its proof, and what it leaves.
        pushed: Stretches in which something pushed, or seemed to.
        budget: Time for it.
        harmful: Whether nothing is left of the set, since all of it harms.
    """
    problem, solution, remaining = judged.problem, judged.solution, judged.remaining
    observed, attempts = problem.observed, Attempts(list(remaining.failures))
    mounted = (problem.first or problem).observed.simulation
    simulation, improved = given.simulation, observed.beside(mounted)
    if not harmful:
        improved = attempts.at(
            "fit to all rows, so the written simulation is the given one",
            lambda: budget.within("a fit to all rows", judged.to_the_end, judged.beside),
            improved,
        )
    contact: tuple[Finding, ...] = ()
    if pushed.seen:
        contact = attempts.at(
            "force of pushes",
            lambda: contact_of(pushed.seen, observed, judged.proven, remaining),
            contact,
        )
    say = partial(_verdict, given, judged, improved, contact, attempts)
    verdict = say(judged.named)
    if doubtful := unsure(verdict.findings, simulation):
        verdict = say([i for i in judged.named if _said(problem, i) not in doubtful])
    shifts = shifts_of(problem, solution)
    said = remarks(
        shifts,
        members=problem.beyond_base(solution.members),
        harmful=harmful,
        passing=sorted({spoken(e.name) for e in improved.simulation.effects if not e.lasts}),
    )
    of_gains = attempts.at(
        "side of the gear",
        lambda: tuple(trusted_gains(verdict.findings, improved.simulation, observed.recordings)),
        (),
    )
    tolerances = left_by_tolerances(problem, solution)
    found = Diagnosis(
        verdict=replace(verdict, notes=(*verdict.notes, *said, *of_gains, *pushed.notes())),
        before=simulation,
        after=_lasting(improved.simulation, simulation),
        recordings=observed.recordings,
        traces=replace(_traces(problem, tolerances, improved.simulated), before=given.simulated),
        explanations=attempts.at(
            "what competed", lambda: explanations_of(problem, solution, remaining.floor), ()
        ),
        tests=attempts.at("nested tests", lambda: tests_of(problem, solution), ()),
        shifts=shifts,
        bandwidth=observed.bandwidth,
    )
    return reduce(Diagnosis.failed, attempts.failures, found)


def _verdict(
    given: Observations,
    judged: JudgedSet,
    improved: Observations,
    contact: tuple[Finding, ...],
    attempts: Attempts,
    named: Sequence[int],
) -> Verdict:
    """Return the verdict on a judged set; members that are not named stand in for others."""
    problem, solution = judged.problem, judged.solution
    mounted = (problem.first or problem).observed.simulation
    verdict = conclude(
        problem,
        solution,
        judged.remaining,
        named,
        judged.unknown,
        judged.proven,
        left_by_tolerances(problem, solution),
        contact,
    )
    if given.simulation.body.gravity != mounted.body.gravity:
        verdict = with_mounting(verdict, given, given.beside(mounted))
    values = attempts.at(
        "values of parameters and their intervals",
        lambda: with_parameters((*verdict.findings, *verdict.identified), improved),
        (*verdict.findings, *verdict.identified),
    )
    return replace(
        verdict,
        findings=tuple(item for item in values if isinstance(item, Finding)),
        identified=tuple(item for item in values if isinstance(item, Identified)),
    )


def _said(problem: RegressionProblem, member: int) -> tuple[str, tuple[int, ...]]:
    """Return effect and joints (1-based) of a candidate, as a finding of it has them."""
    effect, joints = problem.candidates[member].place
    return effect, tuple(j + 1 for j in joints or range(problem.observed.n))


def _lasting(improved: Simulation, given: Simulation) -> Simulation:
    """Return the improved simulation without found effects that other recordings do not share."""
    stated = {effect.place for effect in given.effects}
    kept = tuple(item for item in improved.effects if item.lasts or item.place in stated)
    # what was stated exactly, to prove a set, is tolerated as before
    return replace(improved, effects=kept, tolerances=given.tolerances)


@dataclass(frozen=True)
class _Pushed:
    """Stretches in which something pushed, and those that only looked so until all was out."""

    seen: tuple[Push, ...]
    gone: tuple[Push, ...]

    def notes(self) -> Iterator[str]:
        """Say what is no finding any more; nothing where there is no such thing."""
        if times := [f"{push.start:.1f} to {push.end:.1f} s" for push in self.gone]:
            yield (
                f"What looked like a push at first ({'; '.join(times)}) is explained by what was "
                "found since, and is no finding."
            )


def _without_pushes(
    problem: RegressionProblem, progress: Progress, budget: Budget
) -> tuple[JudgedSet, _Pushed]:
    """Return the set that is found beside pushes, and those: nothing is fitted to events.

    They are sought in what a set of effects leaves, since effects that are not out look like pushes
    themselves. What larger errors hid shows once the whole set is out, and what they feigned is
    gone then: its rows count again.
    """
    first = problem
    problem, solution = solve(problem, progress)
    pushed = pushes(problem.observed, problem.left(solution.fitted))
    if pushed:
        problem, solution = _without(problem, pushed, progress)
    found = budget.within(
        "values that are not linear, and simpler laws",
        lambda: settled(problem, solution, progress),
        None,
    )
    problem, solution = found or (problem, pruned(problem, solution))
    judged, seen = _round(problem, solution, progress, budget)
    for _ in range(ROUNDS.more):
        hidden = tuple(push for push in seen if not _among(push, pushed))
        if not hidden:
            break
        again = partial(_once_more, problem, (*pushed, *hidden), progress, budget)
        more = budget.within("pushes that larger errors hid", again, None)
        if more is None:
            break
        pushed, (problem, judged, seen) = (*pushed, *hidden), more
    sought = pushed
    while (held := tuple(push for push in pushed if _among(push, seen))) != pushed:
        again = partial(_once_more, first, held, progress, budget)
        more = budget.within("rows on which effects feigned a push", again, None)
        if more is None:
            break
        pushed, (_, judged, seen) = held, more
    real = tuple(push for push in seen if _among(push, pushed))
    return judged, _Pushed(real, tuple(push for push in sought if not _among(push, real)))


def _once_more(
    problem: RegressionProblem, pushed: tuple[Push, ...], progress: Progress, budget: Budget
) -> tuple[RegressionProblem, JudgedSet, tuple[Push, ...]]:
    """Solve, settle and judge without the rows of pushes; return the problem with both results."""
    problem, solution = settled(*_without(problem, pushed, progress), progress)
    return problem, *_round(problem, solution, progress, budget)


def _without(
    problem: RegressionProblem, pushed: Sequence[Push], progress: Progress
) -> tuple[RegressionProblem, Solution]:
    """Leave the rows of pushes out, and solve again."""
    return solve(problem.undisturbed(covered(problem.observed, pushed)), progress)


def _round(
    problem: RegressionProblem, solution: Solution, progress: Progress, budget: Budget
) -> tuple[JudgedSet, tuple[Push, ...]]:
    """Judge a settled set; return it with the pushes that are seen in what it leaves."""
    progress("proving on held-out motion", 0.8)
    judged = _around(JudgedSet.of(problem, solution), progress, budget)
    judged = budget.within("a delay of all of it", lambda: _in_time(judged, progress), judged)
    return judged, pushes(problem.observed, judged.proven)


def _among(push: Push, others: Sequence[Push]) -> bool:
    return any(overlap(push, other) for other in others)


def _around(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
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
    again = JudgedSet.of(*settled_around(problem, solution, progress))
    return judged if worse(problem, again.proven, judged.proven, judged.remaining) else again


def _in_time(judged: JudgedSet, progress: Progress) -> JudgedSet:
    """Return what is found around a lateness of all of it, where that predicts no worse.

    It counts if it names a delay, or leaves less unknown than before.
    """
    late = made_late(judged.problem, judged.solution)
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
    if TimeDelay.name not in found and not set(again.unknown) < set(judged.unknown):
        return judged
    return judged if worse(again.problem, again.proven, judged.proven, judged.remaining) else again


def _beyond_tolerances(judged: JudgedSet, progress: Progress, budget: Budget) -> JudgedSet:
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
    again = _around(again, progress, budget)
    found = again.places(again.findings)
    if not found <= judged.places(solution.members) | held:
        return judged
    fewer = set(again.unknown) < set(judged.unknown)
    wrong = set(again.unknown) == set(judged.unknown) and found & held
    if fewer or (wrong and not worse(problem, again.proven, judged.proven, judged.remaining)):
        return again
    return judged


def _traces(problem: RegressionProblem, tolerances: FloatArray, after: FloatArray) -> Traces:
    observed = problem.observed
    slow, kept = observed.slow, observed.kept
    return Traces(
        time=slow.time,
        recording=observed.recording,
        position=slow.position,
        velocity=slow.velocity,
        load=observed.load[kept],
        since_reversal=observed.since_reversal[kept],
        measured=observed.measured,
        before=observed.simulated,
        tolerances=observed.measured - tolerances,
        after=after,
        held_out=np.asarray(problem.split.held_out.any(axis=1)),
        moving=observed.undisturbed(None).moving,
    )
