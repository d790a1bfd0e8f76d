"""Diagnose, plan the motion that would decide, and replay the recorded one on the simulated arm."""

from __future__ import annotations

from dataclasses import replace
from functools import partial, reduce
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.app.library.inputs import recordings_of, simulation_of
from limo_driver.errors import ConfigError, LimoError
from limo_driver.recordings.bandwidth import bandwidth_for

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Sequence
    from pathlib import Path

    from estimators.diagnosis.from_motion.pipeline import DriveDiagnosis
    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.diagnosis.result import Replay
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_DIAGNOSED: Final = 0.85  # of the work
_PLANNED: Final = 0.9
# What a diagnosis reads of long recordings: about 3 kB for each sample, and 60 kB for each row of
# the grid on which it compares. Its time grows with rows, and more of them say little more.
_MOST_SAMPLES: Final = 500_000
_MOST_ROWS: Final = 20_000


def diagnose(
    simulation: Simulation | Path | str,
    recordings: Recording | Path | str | Iterable[Recording | Path | str],
    *,
    bandwidth: float | None = None,
    budget: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis | DriveDiagnosis:
    """Find where a simulation and recordings differ, which physics is missing, and add it.

    Where no torque was recorded, commands and positions identify the drives; errors are then those
    of the closed loop simulated forward [rad], and the result is a `DriveDiagnosis`.

    Args:
        simulation: What is believed of the arm, with its tolerances, or its file.
        recordings: Of that arm: one or several, or their files.
        bandwidth: Of the zero-phase filter on motion and torque [Hz]; if not given, that of the
            simulation, or 10, or what the most slowly sampled recording can bear, unless motion
            held out surely tells more of the torque at another. Not used where no torque was
            recorded.
        budget: Time for the search [s], after which it ends with what is proven by then, and the
            verdict says what was not tried; what no verdict can do without takes as long as it
            takes. Not for recordings without torque.
        progress: Told the stage and the part of the work that is done: never less than before,
            and 1 in the end.

    Returns:
        The verdict, the improved `simulation`, the evidence; one more motion, where that would
        decide between explanations; and the recorded motion replayed on the simulated arm. Where a
        stage fails without which there is still a verdict, that says so, and `failures` has the
        error.

    Raises:
        RecordingError: The recordings cannot be used, are of another robot, or one is given twice.
        ConfigError: The budget is not above 0, or given where there is no torque.

    Example:
        >>> found = limo.diagnose("sim.yaml", ["run.parquet", "other.parquet"])
        >>> found.save("diagnosis/")
    """
    from estimators.diagnosis import diagnose as diagnosed
    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.diagnosis.from_torque.residuals.noise import above_note
    from estimators.diagnosis.stages import Attempts, Budget, forward, quiet

    if budget is not None and not budget > 0:
        raise ConfigError(f"budget is {budget:g} s, expected above 0")
    time = Budget() if budget is None else Budget(budget)
    tell = forward(progress or quiet)
    known, measured = simulation_of(simulation), recordings_of(recordings)
    if measured and not any(recording.has_torque for recording in measured):
        from estimators.diagnosis.from_motion import diagnose_drives

        if budget is not None:
            raise ConfigError("`budget` is for recordings with torque, and these have none")
        return diagnose_drives(known, measured, tell)
    width, chosen = _bandwidth(known, measured, bandwidth)
    measured = _within_memory(measured, width)
    found = diagnosed(known, measured, width, forward(tell, _DIAGNOSED), time)
    if chosen and found.after != found.before:
        found = replace(found, after=replace(found.after, bandwidth=width))
    attempts = Attempts()
    tell("planning the next motion", _DIAGNOSED)
    planned = partial(time.within, "the next motion", partial(with_next_motion, found))
    found = attempts.at(
        "next motion", lambda: planned(_without_motion(found)), _without_motion(found)
    )
    tell("replaying on the simulated robot", _PLANNED)
    played = partial(time.within, "a replay", partial(with_replay, found))
    found = attempts.at("replay on the simulated robot", lambda: played(found), found)
    above = attempts.at(
        "errors above the bandwidth", lambda: above_note(found.simulation, measured, width), ""
    )
    notes = filter(None, (*chosen, above, time.note()))
    found = replace(found, verdict=replace(found.verdict, notes=(*found.verdict.notes, *notes)))
    tell("done", 1.0)
    return reduce(Diagnosis.failed, attempts.failures, found)


def _bandwidth(
    simulation: Simulation, recordings: Sequence[Recording], asked: float | None
) -> tuple[float, tuple[str, ...]]:
    """Return the bandwidth [Hz] at which recordings are compared, and why, if it is unusual."""
    from estimators.diagnosis.settings.residuals import ROWS
    from estimators.rigid_body.best_bandwidth import fitting_bandwidth

    usual = bandwidth_for(recordings, asked, simulation.bandwidth)
    width, why = fitting_bandwidth(simulation, recordings, asked, most=usual)
    seconds = sum(len(recording) / recording.rate for recording in recordings)
    while why and ROWS.per_bandwidth * width * seconds < ROWS.least:
        width *= 2.0  # or too few rows are left
    return (width, why) if width < usual else (usual, ())


def _within_memory(recordings: tuple[Recording, ...], bandwidth: float) -> tuple[Recording, ...]:
    """Return stretches of recordings that are longer than memory and time should bear."""
    from estimators.diagnosis.settings.residuals import ROWS

    samples = sum(map(len, recordings))
    rows = ROWS.per_bandwidth * bandwidth * sum(len(r) / r.rate for r in recordings)
    part = min(_MOST_SAMPLES / max(samples, 1), _MOST_ROWS / max(rows, 1.0))
    if part >= 1.0:
        return recordings
    return tuple(r.at_most(int(part * len(r))) for r in recordings)


def _without_motion(found: Diagnosis, note: str = "") -> Diagnosis:
    verdict = replace(found.verdict, next_motion=None)
    return replace(found, verdict=verdict, next_motion=None, next_motion_note=note)


def with_next_motion(found: Diagnosis) -> Diagnosis:
    """Add the motion in which effects differ that the recordings cannot distinguish, if any."""
    from estimators.diagnosis.verdict import NEXT_MOTION, NextMotion
    from limopa.feasibility import WAY_OUT
    from limopa.separation.separation import SEPARATION, motion_for, purpose_of

    refused = ""
    for pair, joints in _ambiguous(found.verdict, found.before.model.n):
        try:
            motion = motion_for(found.before.model, joints, pair, _start_poses(found))
        except LimoError as error:
            why = str(error).removeprefix(f"{SEPARATION}: ").removesuffix(f"; {WAY_OUT}")
            refused = refused or f"No motion to record next is proposed: {why}."
            continue
        wanted = NextMotion((pair,), NEXT_MOTION)
        return replace(
            found,
            verdict=replace(found.verdict, next_motion=wanted),
            next_motion=motion,
            next_motion_purpose=purpose_of(pair, joints),
        )
    return _without_motion(found, refused)


def _ambiguous(
    verdict: Verdict, n: int
) -> Generator[tuple[tuple[str, str], tuple[int, ...]], None, None]:
    """Yield pairs of effects that are indistinguishable in the recordings, and their joints."""
    every = tuple(range(1, n + 1))
    wanted = verdict.next_motion.separates if verdict.next_motion else ()
    for pair in wanted:
        joints = [item.joints for item in verdict.findings if item.effect in pair]
        yield pair, (joints[0] if joints else ()) or every
    for item in verdict.findings:
        for other in item.equivalent:
            if (item.effect, other) not in wanted:
                yield (item.effect, other), item.joints or every


def _start_poses(found: Diagnosis) -> FloatArray:
    """Return poses along the recordings, (k, n) [rad]."""
    from estimators.diagnosis.settings.judgement import SEPARATION

    count = SEPARATION.start_poses
    poses = np.concatenate(
        [r.position[np.linspace(0, len(r) - 1, count).astype(int)] for r in found.recordings]
    )
    return poses - found.before.model.whole_turns(poses)


def with_replay(found: Diagnosis) -> Diagnosis:
    """Add the torque that the simulated robot measures as it follows the recorded motion."""
    try:
        return replace(found, replay=(_replay(found),))
    except LimoError as error:
        return replace(found, replay_note=f"The motion was not replayed: {error}.")


def _replay(found: Diagnosis) -> Replay:
    """Replay the stretch in which recording and simulation differ most."""
    from backends.mujoco_sim.replay import follow
    from estimators.diagnosis.report import worst_stretch
    from estimators.diagnosis.result import Replay
    from estimators.diagnosis.settings.judgement import LOOPS, REPLAY

    floor = np.array(found.verdict.fit.noise_floor)
    worst = worst_stretch(found.traces, floor, LOOPS.duration)
    recording = found.recordings[worst.recording]
    stretch = (recording, worst.start, worst.stop, found.bandwidth)
    before = follow(found.before, *stretch)
    after = before if found.after == found.before else follow(found.after, *stretch)
    rows = (recording.time >= worst.start) & (recording.time <= worst.stop)
    every = slice(None, None, max(1, int(recording.rate / REPLAY.rate)))
    time = before.time[every]
    scored = np.searchsorted(found.traces.time[worst.rows], time, side="right") - 1
    return Replay(
        time=time,
        measured=recording.filtered_torque(found.bandwidth)[rows][every],
        before=before.torque[every],
        after=after.torque[every],
        tracking=after.tracking,
        moving=found.traces.moving[worst.rows][np.maximum(scored, 0)],
        recording=worst.recording,
        position=recording.position[rows][every],
        position_before=before.position[every],
        position_after=after.position[every],
        sliding=found.before.model.sliding,
    )
