"""Identification and diagnosis of an arm that tells no torque: its drives and its friction.

The score is what users see: the position error of the closed loop simulated forward from the
commands alone, on motion that nothing was fitted to.

The page of drives that were identified from commands and positions.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final

import numpy as np
from threadpoolctl import threadpool_limits

from estimators.diagnosis.from_motion.checks.conventions import (
    as_counted,
    confirmed,
    conventions_of,
    from_zeros,
    with_zeros,
    without_zeros,
    zeros_of,
)
from estimators.diagnosis.from_motion.checks.recorded import check_commanded
from estimators.diagnosis.from_motion.fitting.identification import fit_drives, with_servos
from estimators.diagnosis.from_motion.held_out import (
    CONFIDENT,
    DriveEvidence,
    Fold,
    position_errors,
    removes,
    resolution_of,
    split,
)
from estimators.diagnosis.from_motion.search import Searched, fit_without, is_needed, search
from estimators.diagnosis.from_motion.simulation.loads import ArmChange, ArmLoads, as_described
from estimators.diagnosis.from_motion.simulation.plant import rows_of, tolerances_of
from estimators.diagnosis.from_motion.stated import (
    is_stated,
    prove_on_part,
    stated_arm,
    with_intervals,
)
from estimators.diagnosis.from_motion.suspects import COUNTED
from estimators.diagnosis.from_motion.verdict import (
    about_counting,
    about_drift,
    about_motors,
    about_scale,
    not_shown,
    plays,
    sags,
    verdict_of,
)
from estimators.diagnosis.report.without_torque import drive_report
from estimators.diagnosis.result import DriveReplay, DriveResult
from estimators.diagnosis.stages import quiet
from estimators.diagnosis.verdict import IMPROVED, NEXT_MOTION, REPORT, VERDICT
from limo_driver.model.units import unit_of
from limo_driver.pages import Charts, Page
from limo_driver.pages.figures import AFTER, layout, numbers
from limo_driver.pages.markup import columns, header, listed, next_steps, section
from limo_driver.quoting import in_shell
from limo_driver.runtime.outputs import require_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_motion.fitting.identification import DriveIdentification
    from estimators.diagnosis.stages import Progress
    from limo_driver.pages.markup import Figure
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_TURNS: Final = 2  # findings of how joints count, after each of which all is looked for anew


@threadpool_limits.wrap(limits=1, user_api="blas")  # more collapse on busy cores, and gain nothing
def identify_drives(
    simulation: Simulation, recordings: Sequence[Recording], *, intervals: bool = True
) -> DriveIdentification:
    """Identify drives and friction of an arm, from commands and positions alone.

    Args:
        simulation: The rigid body, and what is believed of the drives; a joint without one gets a
            position servo.
        recordings: With commands, of that robot.
        intervals: Whether fits that leave motion out tell how sure values are; a third of the time.
            Without, deviations are those of a model that explains all of the motion.

    Returns:
        A simulation that can be run forward, how sure its values are, and what makes one doubt the
        recordings.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: A recording is of another robot, given twice, or its commands are not
            set-points of its joints in rad.
    """
    odd = check_commanded(simulation, recordings)
    given, commanded = with_servos(simulation, recordings)
    zero = zeros_of(given)
    recorded = [from_zeros(recording, zero) for recording in commanded]
    found = fit_drives(without_zeros(given), recorded, intervals=intervals)
    return replace(found, simulation=with_zeros(found.simulation, zero), warnings=odd)


@threadpool_limits.wrap(limits=1, user_api="blas")  # more collapse on busy cores, and gain nothing
def diagnose_drives(
    simulation: Simulation, recordings: Sequence[Recording], progress: Progress = quiet
) -> DriveDiagnosis:
    """Find which drives and which friction an arm has, from commands and positions alone.

    Args:
        simulation: The rigid body, and what is believed of the drives.
        recordings: One or more of that arm, with commands.
        progress: Told the stage and the part that is done.

    Returns:
        The verdict, and a simulation that can be run forward from commands.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: A recording is of another robot, given twice, or its commands are not
            set-points of its joints in rad.
    """
    progress("reading motion", 0.0)
    odd = check_commanded(simulation, recordings)
    simulation = simulation.with_motors(recordings[0].channels)
    given, commanded = with_servos(simulation, recordings)
    zero, given = zeros_of(given), without_zeros(given)
    recordings = [from_zeros(recording, zero) for recording in commanded]
    seen, unseen = split(recordings)
    progress("fitting drives and friction", 0.05)
    stated = is_stated(simulation, seen)
    evidence = (
        _beside_stated(given, seen, unseen, recordings, progress)
        if stated
        else _identified(given, seen, unseen, recordings, progress)
    )
    evidence = _with_zeros(evidence, zero)
    proof, final = evidence.proof, evidence.final
    before = position_errors(given, unseen)
    after = position_errors(proof.simulation, evidence.unseen)
    progress("comparing", 0.9)
    delay = float(np.median([fit.value("delay") for fit in final.fits]))
    likeliest = conventions_of(given.body, evidence.recordings, delay)
    conventions = confirmed(given, evidence.recordings, likeliest)
    notes = (
        *odd,
        conventions.sentence(),
        *(about_counting(one) for one in evidence.turned),
        *about_scale(final, stated=stated),
        *about_drift(given),
        *(about_motors(simulation) if stated else ()),
        *sags(final),
        *plays(final.fits, final.simulation.model.sliding),
    )
    hidden = not_shown(given, conventions.determined, stated=stated)
    verdict = verdict_of(simulation, given, evidence, before, after, notes, hidden)
    progress("done", 1.0)
    return DriveDiagnosis(
        verdict,
        simulation,
        with_zeros(final.simulation, np.array(evidence.zeros)),
        tuple(commanded),
        held_out_error=(
            tuple(np.abs(before).mean(axis=0).tolist()),
            tuple(np.abs(after).mean(axis=0).tolist()),
        ),
        replay=_replay(evidence, unseen[0], before, after),
    )


def _with_zeros(evidence: DriveEvidence, zero: FloatArray) -> DriveEvidence:
    """Return evidence with the stated zeros, (n,) [rad], of joints as the description counts."""
    for one in reversed(evidence.turned):  # that which was found first is the last
        zero = as_counted(zero, one.counted(ArmChange.none(zero.size)))
    return replace(evidence, zeros=tuple(zero.tolist()))


def _replay(
    evidence: DriveEvidence, first: Recording, before: FloatArray, after: FloatArray
) -> DriveReplay:
    """Return the first recording that was held out, beside what both simulations made of it.

    Args:
        evidence: With that recording as the description counts.
        first: The same as it came.
        before: Errors of the given simulation on all rows held out, (K, n) [rad].
        after: The same of the improved one.
    """
    counted, rows = evidence.unseen[0], slice(len(first))
    given = first.position + before[rows]
    # where joints count against the description, positions of both are as it counts
    other = counted.position - first.position
    return DriveReplay(counted, given + other, counted.position + after[rows])


def _identified(
    given: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress,
) -> DriveEvidence:
    """Identify drives of which nothing is believed, from a part of the recordings and from all.

    Both at once: each of them ends with one joint that takes longest, and one processor alone.
    """
    with ThreadPoolExecutor() as pool:
        whole = pool.submit(fit_drives, given, recordings)
        proof = fit_drives(given, seen, intervals=False)
        progress("fitting to all motion", 0.4)
        final = whole.result()
    return DriveEvidence(proof, final, tuple(recordings), tuple(unseen))


def _beside_stated(
    given: Simulation,
    seen: Sequence[Recording],
    unseen: Sequence[Recording],
    recordings: Sequence[Recording],
    progress: Progress,
    turns: int = 0,
) -> DriveEvidence:
    """Look for what the arm has beyond what is stated, and prove it on a part of the recordings."""
    ticks = np.array([resolution_of(recordings, j) for j in range(given.model.n)])
    loads = ArmLoads(given.body, recordings, rows_of(given))
    searched = search(loads, rows_of(given), tolerances_of(given), float(ticks.max()))
    arm = stated_arm(given, searched, searched.fit)
    other = tuple(one for one in arm.suspects if one.effect in COUNTED)
    if other and turns < _TURNS:
        as_recorded = tuple(unseen)
        seen, unseen, every = (
            [as_described(r, arm.change) for r in x] for x in (seen, unseen, recordings)
        )
        evidence = _beside_stated(given, seen, unseen, every, progress, turns + 1)
        counted = DriveEvidence(
            arm.identified,
            arm.identified,
            tuple(recordings),
            as_recorded,
            shared=(arm, arm),
            counted=evidence.counted,
        )
        return replace(evidence, turned=(*evidence.turned, *other), counted=counted)
    progress("proving on held-out motion", 0.6)
    final = with_intervals(given, searched, ticks)
    while (doubtful := final.doubtful) is not None:
        searched = fit_without(searched, doubtful)
        final = with_intervals(given, searched, ticks)
    proven, folds, refitted = _proven(given, ((seen, unseen), (unseen, seen)), searched)
    if proven is not searched:
        final = with_intervals(given, proven, ticks)
    proof = prove_on_part(given, seen, proven)
    return DriveEvidence(
        proof.identified,
        final.identified,
        tuple(recordings),
        tuple(unseen),
        shared=(proof, final),
        exchanged=folds,
        refitted=refitted,
    )


def _proven(
    given: Simulation,
    pairs: Sequence[tuple[Sequence[Recording], Sequence[Recording]]],
    searched: Searched,
) -> tuple[Searched, tuple[Fold, ...], dict[tuple[int, str], FloatArray]]:
    """Leave out what a joint does without: where all else, fitted again, errs no more.

    What all else would have to be far from what is stated for stays, and counts as it is undone.

    Returns:
        What is left, its errors on each part that is held out, and the squared ones of its joint
        without each effect, likewise (K,) [rad²].
    """

    def folds_of(found: Searched) -> tuple[Fold, ...]:
        arms = [(prove_on_part(given, own, found, held=True), other) for own, other in pairs]
        return tuple(Fold(arm.identified, tuple(other), arm) for arm, other in arms)

    folds = folds_of(searched)
    refitted: dict[tuple[int, str], FloatArray] = {}
    for one in searched.suspects:
        if one.joint is None or one.shared or one.freed:
            continue
        less = fit_without(searched, one)
        full, without = (
            np.concatenate([fold.squares(fold.loads(given))[one.joint] for fold in own])
            for own in (folds, folds_of(less))
        )
        if removes(full, without, len(pairs)) >= CONFIDENT:
            refitted[one.joint, one.effect] = without
        elif not is_needed(searched, one):
            return _proven(given, pairs, less)
    return searched, folds, refitted


@dataclass(frozen=True, repr=False)
class DriveDiagnosis(DriveResult):
    """Verdict, improved simulation and evidence of an arm that tells commands and positions."""

    def save(self, folder: Path | str) -> tuple[Path, ...]:
        """Write verdict.json, sim.yaml and report.html, and return their paths.

        Args:
            folder: Made if it is not there.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        out = Path(folder)
        require_folder(out, "the diagnosis", (VERDICT, IMPROVED, REPORT, NEXT_MOTION))
        (out / NEXT_MOTION).unlink(missing_ok=True)
        self.verdict.save(out / VERDICT)
        self.after.save(out / IMPROVED)
        drive_report(self).save(out / REPORT)
        return out / VERDICT, out / IMPROVED, out / REPORT


_LEAD: Final = (
    "Position errors of each joint, simulated forward from its commands. Where gravity hardly "
    "loads a joint, only ratios of its constants are known: they are given for the scale that the "
    "file believes."
)


def drives_page(found: DriveIdentification, file: str) -> Page:
    """Return the page of an identification without torque.

    Args:
        found: What was identified.
        file: Name of the simulation's file, for the commands that go on from it.
    """
    sim = in_shell(PurePath(file))
    charts, model = Charts(), found.simulation.model
    title = found.headline()
    title = f"{title[:1].upper()}{title[1:]}."
    unsure = [
        f"Joint {joint}: recordings at this rate do not show its {name}."
        for joint, name in found.undecided
    ]
    drawn = charts.place(_errors(found), "Error of each joint")
    body = (
        header(f"Drives of {model.name}", title)
        + section("Notes", listed([*found.warnings, *unsure]), "notes")
        + section("Drives and friction", drawn + columns(found.figures()), "joints", _LEAD)
        + next_steps(
            [
                (
                    "Ask another recording what these drives leave out.",
                    f"limo diagnose OTHER_RECORDING --sim {sim} --out diagnosis/",
                ),
                (
                    "Put the values into a copy of your own MJCF.",
                    f"limo export {sim} --to mjcf --out identified/",
                ),
            ]
        )
    )
    return Page(title, body, charts, sliding=found.simulation.model.sliding)


def _errors(found: DriveIdentification) -> Figure:
    bars = {
        "type": "bar",
        "orientation": "h",
        "y": list(found.simulation.model.joint_names),
        "x": numbers(np.array([fit.mean_error for fit in found.fits])),
        "marker": {"color": AFTER},
        "hovertemplate": "%{y}: %{x}<extra></extra>",
    }
    axes = layout(f"mean error [{unit_of('rad', found.simulation.model.sliding)}]", "")
    axes["yaxis"] |= {"autorange": "reversed"}
    return {"data": [bars], "layout": axes, "rows": len(found.fits)}
