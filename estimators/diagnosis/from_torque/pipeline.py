"""The pipeline: from recordings and a simulation to a diagnosis, one stage after the other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.base import check_different
from estimators.diagnosis.from_torque.contact import contact_of
from estimators.diagnosis.from_torque.events import Events, apart_from_events, beyond_tolerances
from estimators.diagnosis.from_torque.fitting.contribution import left_by_tolerances
from estimators.diagnosis.from_torque.fitting.problem import RegressionProblem
from estimators.diagnosis.from_torque.judgement.conclusion import (
    conclude,
    explanations_of,
    shifts_of,
)
from estimators.diagnosis.from_torque.judgement.intervals import with_parameters
from estimators.diagnosis.from_torque.judgement.judgement import remarks, trusted_gains
from estimators.diagnosis.from_torque.judgement.questions import (
    guessed_notes,
    tests_of,
    unsure,
    with_guesses,
)
from estimators.diagnosis.from_torque.judgement.stated_values import stated_values
from estimators.diagnosis.from_torque.judgement.telling import with_offsets, without_unreported
from estimators.diagnosis.from_torque.judgement.writing import Written, written
from estimators.diagnosis.from_torque.residuals.body_fit import as_mounted, with_mounting
from estimators.diagnosis.from_torque.residuals.observations import Observations
from estimators.diagnosis.from_torque.residuals.plausibility import check_plausible
from estimators.diagnosis.from_torque.residuals.usable_joints import left_out
from estimators.diagnosis.report import write_report
from estimators.diagnosis.result import DiagnosisResult, Traces
from estimators.diagnosis.stages import Attempts, Budget, Failure, Progress, forward, quiet
from estimators.diagnosis.verdict import IMPROVED, NEXT_MOTION, REPORT, VERDICT, Finding, Identified
from limo_driver.errors import ConfigError, LimoError, RecordingError
from limo_driver.physics import Tolerances, display_name
from limo_driver.recordings.bandwidth import BANDWIDTH
from limo_driver.runtime.outputs import require_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.judgement.judged_set import JudgedSet
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FILES: Final = (VERDICT, IMPROVED, REPORT, NEXT_MOTION)


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
    simulation = with_guesses(simulation, recordings)
    budget = budget or Budget()
    progress = budget.watched(forward(progress))
    progress("reading motion", 0.0)
    given = observe(simulation, recordings, bandwidth)
    problem = RegressionProblem.of(as_mounted(given), progress)
    judged, events = apart_from_events(problem, progress, budget)
    judged = budget.within(
        "values beyond their tolerances",
        lambda: beyond_tolerances(judged, progress, budget),
        judged,
    )
    judged, harmful = judged.without_harmful_members()
    judged = judged.beyond_ordinary()
    progress("fitting to all rows", 0.95)
    found = _concluded(given, judged, events, budget, harmful=harmful)
    progress("done", 1.0)
    return found


def _concluded(
    given: Observations,
    judged: JudgedSet,
    events: Events,
    budget: Budget,
    *,
    harmful: bool,
) -> Diagnosis:
    """Fit a judged set to all rows, and return what is to be said of it.

    Args:
        given: The recordings beside the given simulation.
        judged: The set, its proof, and what it leaves.
        events: Stretches that nothing was fitted to.
        budget: Time for it.
        harmful: Whether nothing is left of the set, since all of it harms.
    """
    problem, solution, remaining = judged.problem, judged.solution, judged.remaining
    observed, attempts = problem.observed, Attempts(list(remaining.failures))
    mounted = (problem.first or problem).observed.simulation
    simulation, improved = given.simulation, observed.under(mounted)
    if not harmful:
        improved = attempts.at(
            "fit to all rows, so the written simulation is the given one",
            lambda: budget.within("a fit to all rows", judged.to_the_end, judged.beside),
            improved,
        )
    whole, fit, keep = judged, improved, Written(judged, improved)
    if not harmful:
        keep = attempts.at(
            "proof on motion of another kind",
            lambda: budget.within(
                "a proof on motion of another kind",
                lambda: written(judged, improved, simulation),
                keep,
            ),
            keep,
        )
    judged, improved = keep.judged, keep.improved
    contact: tuple[Finding, ...] = ()
    if events.pushes:
        contact = attempts.at(
            "force of pushes",
            lambda: contact_of(events.pushes, observed, judged.proven, remaining),
            contact,
        )
    say = partial(_verdict, given, judged, fit, contact, attempts)
    named = list(judged.named)
    verdict = say(named)
    if doubtful := unsure(verdict.findings, simulation):
        dropped = [i for i in judged.named if _place_of(problem, i) in doubtful]
        # which law of its friction a joint follows is doubtful, and not that it has some
        if not harmful and (plain := judged.with_plain_friction(dropped)) is not judged:
            return _concluded(given, plain, events, budget, harmful=harmful)
        named = [i for i in named if i not in dropped]
        verdict = say(named)
    values = attempts.at(
        "values that differ from the stated ones",
        lambda: stated_values(whole, fit, mounted, verdict.findings),
        (),
    )
    stated = replace(verdict, values=values)
    final = with_offsets(without_unreported(keep, stated), stated)
    if final is not keep:
        keep, judged, improved = final, final.judged, final.improved
        verdict = _verdict(given, judged, fit, contact, attempts, named)
    shifts, after = shifts_of(solution), _lasting(keep, simulation)
    passing = {display_name(e.name) for e in improved.simulation.effects if e not in after.effects}
    remarked = remarks(
        shifts,
        members=problem.beyond_base(solution.members),
        harmful=harmful,
        passing=sorted(passing),
        recordings=len(observed.recordings),
    )
    of_gains = attempts.at(
        "side of the gear",
        lambda: tuple(trusted_gains(verdict.findings, improved.simulation, observed.recordings)),
        (),
    )
    of_guesses = attempts.at(
        "other tolerances than those guessed",
        lambda: budget.within(
            "other tolerances than those guessed",
            lambda: tuple(guessed_notes(judged, simulation)),
            (),
        ),
        (),
    )
    tolerances = left_by_tolerances(solution)
    found = Diagnosis(
        verdict=replace(
            verdict,
            values=values,
            notes=(
                *verdict.notes,
                *keep.notes(),
                *remarked,
                *of_gains,
                *of_guesses,
                *events.notes(len(observed.recordings)),
            ),
            fit=replace(verdict.fit, left_out=keep.kind),
            withheld=tuple(item.part for item in keep.withheld),
        ),
        before=simulation,
        after=after,
        recordings=observed.recordings,
        traces=replace(_traces(problem, tolerances, improved.simulated), before=given.simulated),
        explanations=attempts.at(
            "what competed", lambda: explanations_of(solution, remaining.floor), ()
        ),
        tests=attempts.at("nested tests", lambda: tests_of(solution), ()),
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
        solution,
        judged.remaining,
        named,
        judged.unknown,
        judged.proven,
        left_by_tolerances(solution),
        contact,
    )
    if given.simulation.body.gravity != mounted.body.gravity:
        verdict = with_mounting(verdict, given, given.under(mounted))
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


def _place_of(problem: RegressionProblem, member: int) -> tuple[str, tuple[int, ...]]:
    """Return effect and joints (1-based) of a candidate, as a finding of it has them."""
    effect, joints = problem.candidates[member].place
    return effect, tuple(j + 1 for j in joints or range(problem.observed.n))


def _lasting(found: Written, given: Simulation) -> Simulation:
    """Return the improved simulation without found effects that other recordings do not share."""
    stated, improved = {effect.place for effect in given.effects}, found.improved.simulation
    kept = tuple(
        item
        for item in improved.effects
        if item.persists or item.place in stated or found.recurs(item)
    )
    # what was stated exactly, to prove a set, is tolerated as before
    known = given.tolerances
    if "gain" in known.assumed:  # that of these recordings: others may be of no currents
        known = replace(known, gain=Tolerances().gain)
    return replace(improved, effects=kept, tolerances=known)


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
        sliding=observed.simulation.model.sliding,
        moving=observed.undisturbed(None).moving,
    )


def save(found: Diagnosis, folder: Path | str) -> tuple[Diagnosis, tuple[Path, ...]]:
    """Write the files of a diagnosis; those of one before it that are not written are removed.

    Verdict, simulation and next motion are there before the report is made. Where that fails, the
    verdict is written once more, with a note.

    Args:
        found: What to save.
        folder: Made if it is not there.

    Returns:
        The diagnosis, with the failure of its report if that failed, and the files written.

    Raises:
        ConfigError: The folder cannot be written to.
    """
    out = Path(folder)
    require_folder(out, "the diagnosis", FILES)
    written = [out / VERDICT, out / IMPROVED]
    try:
        found.verdict.save(out / VERDICT)
        found.simulation.save(out / IMPROVED)
        (out / NEXT_MOTION).unlink(missing_ok=True)
        if found.next_motion is not None:
            found.next_motion.save(out / NEXT_MOTION)
            written.append(out / NEXT_MOTION)
        try:
            write_report(found, out / REPORT)
            written.append(out / REPORT)
        except (LimoError, OSError):  # nothing can be written, a verdict as little
            raise
        except Exception as error:  # noqa: BLE001  # whatever it is, the verdict is known
            (out / REPORT).unlink(missing_ok=True)
            found = found.failed(Failure("report", error))
            found.verdict.save(out / VERDICT)
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error}", path=out) from None
    return found, tuple(written)


@dataclass(frozen=True, repr=False)
class Diagnosis(DiagnosisResult):
    """Result of a diagnosis: verdict, improved simulation, and evidence."""

    def save(self, folder: Path | str) -> None:
        """Write verdict.json, sim.yaml, report.html, and next_motion.parquet if there is one.

        Where the report fails, the others are written all the same, and the verdict says so.

        Args:
            folder: Made if it is not there.

        Raises:
            ConfigError: The folder cannot be written to.
            Exception: What the report failed with.
        """
        saved, _ = save(self, folder)
        for failure in saved.failures[len(self.failures) :]:
            raise failure.error
