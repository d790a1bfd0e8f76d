"""Diagnose, plan the motion that would decide, and replay the recorded one on the simulated arm."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Sequence

    from estimators.diagnosis.result import Diagnosis, Replay
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

REPLAYED: Final = (12.0, 5.0)  # [s] of recorded motion that the arm follows; with many effects
MANY_EFFECTS: Final = 40  # of which most are evaluated in every cycle, one by one
REPLAY_RATE: Final = 100.0  # [Hz] of the rows that are kept of it
START_POSES: Final = 6  # of each recording, around which a next motion is tried
_DIAGNOSED: Final = 0.85  # of the work


def diagnose(
    simulation: Simulation,
    recordings: Sequence[Recording],
    *,
    bandwidth: float = 10.0,
    progress: Callable[[str, float], None] | None = None,
) -> Diagnosis:
    """Find where a simulation and recordings differ, which physics is missing, and add it.

    Args:
        simulation: What is believed of the arm, with its tolerances.
        recordings: One or more of that arm.
        bandwidth: Of the zero-phase filter on motion and torque [Hz].
        progress: Told the stage and the part of the work that is done, 0 to 1.

    Returns:
        The verdict, the improved `simulation`, the evidence; one more motion, where that would
        decide between explanations; and the recorded motion replayed on the simulated arm.

    Raises:
        RecordingError: The recordings cannot be used, are of another robot, or one is given twice.

    Example:
        >>> found = diagnose(Simulation.load("sim.yaml"), [Recording.load("run.parquet")])
        >>> found.save("diagnosis/")
    """
    from estimators.diagnosis import diagnose as diagnosed

    tell = progress or _quiet
    found = diagnosed(
        simulation, recordings, bandwidth, lambda stage, part: tell(stage, _DIAGNOSED * part)
    )
    tell("planning the next motion", _DIAGNOSED)
    found = with_next_motion(found)
    tell("replaying on the simulated robot", 0.9)
    return with_replay(found)


def _quiet(_stage: str, _part: float) -> None:
    """Tell nobody."""


def with_next_motion(found: Diagnosis) -> Diagnosis:
    """Add the motion in which effects differ that the recordings cannot distinguish, if any."""
    from estimators.diagnosis.verdict import NEXT_MOTION, NextMotion
    from limopa.separation.separation import motion_for, purpose_of

    refused = ""
    for pair, joints in _ambiguous(found.verdict, found.before.model.n):
        try:
            motion = motion_for(found.before.model, joints, pair, _start_poses(found.recordings))
        except LimoError as error:
            refused = refused or f"No next motion: {error}."
            continue
        wanted = NextMotion((pair,), NEXT_MOTION)
        return replace(
            found,
            verdict=replace(found.verdict, next_motion=wanted),
            next_motion=motion,
            next_motion_purpose=purpose_of(pair, joints),
        )
    verdict = replace(found.verdict, next_motion=None)
    return replace(found, verdict=verdict, next_motion=None, next_motion_purpose=refused)


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


def _start_poses(recordings: Sequence[Recording]) -> FloatArray:
    """Return poses along the recordings, (k, n) [rad]."""
    return np.concatenate(
        [r.position[np.linspace(0, len(r) - 1, START_POSES).astype(int)] for r in recordings]
    )


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

    floor = np.array(found.verdict.fit.noise_floor)
    duration = REPLAYED[len(found.after.effects) > MANY_EFFECTS]
    worst = worst_stretch(found.traces, floor, duration)
    recording = found.recordings[worst.recording]
    stretch = (recording, worst.start, worst.stop, found.bandwidth)
    before = follow(found.before, *stretch)
    after = before if found.after == found.before else follow(found.after, *stretch)
    rows = (recording.time >= worst.start) & (recording.time <= worst.stop)
    every = slice(None, None, max(1, int(recording.rate / REPLAY_RATE)))
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
    )
