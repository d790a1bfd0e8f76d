"""Jolts: short stretches in which errors of several joints are far larger than usual at once.

A controller that stalls for some milliseconds, or a brake, makes an arm ring at frequencies that no
slow physics reaches; a part of the log that is missing looks much the same. Half a second of that
may double the noise of a whole recording, and hide all that is smaller. So nothing is fitted to
those rows, nor to those to which the filter spreads them, and a note says when they are. Joints
that start, stop or turn do not count: what friction does there is physics.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.noise import usual_errors
from estimators.diagnosis.from_torque.residuals.pushes import overlap
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from estimators.diagnosis.settings.pushes import JOLTS, PUSHES
from estimators.diagnosis.wording import listed, rounded

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.from_torque.residuals.pushes import TimeSpan
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class Jolt:
    """When the arm was jolted, in the time of one recording."""

    recording: int  # 0-based
    start: float  # [s]
    end: float  # [s]
    joints: tuple[int, ...]  # 0-based, whose errors are far larger than usual
    times: float  # usual errors, at most


def jolts(
    observed: Observations, residual: FloatArray, events: Sequence[TimeSpan]
) -> tuple[Jolt, ...]:
    """Return the jolts of all recordings; none where that recurs.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        residual: What a fit leaves, (K, n) [N m].
        events: Stretches that are known to be something else, such as pushes.
    """
    observed = observed.undisturbed(None)
    steady = steadily_moving(observed)
    known = steady.sum(axis=0) >= JOLTS.fewest
    usual = usual_errors(residual, steady)
    errors = np.where(
        steady & known, np.abs(residual) / np.maximum(usual, observed.least_noise), 0.0
    )
    large = errors > JOLTS.outstanding
    rows = np.flatnonzero(large.sum(axis=1) >= JOLTS.joints)
    if not rows.size or rows.size > JOLTS.most * np.count_nonzero(steady.any(axis=1)):
        return ()
    time, recording = observed.slow.time[rows], observed.recording[rows]
    apart = (np.diff(time) > JOLTS.apart) | (np.diff(recording) != 0)
    found = [
        Jolt(
            int(observed.recording[own[0]]),
            float(observed.slow.time[own[0]]),
            float(observed.slow.time[own[-1]]),
            tuple(np.flatnonzero(large[own].any(axis=0)).tolist()),
            float(errors[own].max()),
        )
        for own in np.split(rows, np.flatnonzero(apart) + 1)
    ]
    return tuple(jolt for jolt in found if not any(overlap(jolt, event) for event in events))


def note(found: Sequence[Jolt], recordings: int) -> str:
    """Say when an arm was jolted.

    Args:
        found: The jolts, at least one, those of a recording one after the other.
        recordings: How many there are; which one it is goes without saying where there is one.
    """
    joints = sorted({joint + 1 for jolt in found for joint in jolt.joints})
    times = times_of(found, recordings)
    return (
        f"At {times} the errors of joints {listed([str(j) for j in joints])} are "
        f"up to {rounded(max(jolt.times for jolt in found), 2)} times the usual ones at once, for "
        "a moment: a jolt, or a fault of the log. What lies within "
        f"{PUSHES.spread:g} s of that is neither fitted nor judged."
    )


def times_of(found: Sequence[TimeSpan], recordings: int) -> str:
    """Say when events begin, one recording after the other; of so many recordings."""
    return " and at ".join(
        f"{_times(list(own))}{f' of recording {recording + 1}' * (recordings > 1)}"
        for recording, own in groupby(found, lambda event: event.recording)
    )


def _times(found: Sequence[TimeSpan]) -> str:
    """Say when the events of one recording begin; of many, when the first ones do."""
    said = [f"{event.start:.1f} s" for event in found[: JOLTS.said]]
    more = len(found) - len(said)
    return listed([*said, f"{more} other time{'s' * (more > 1)}"] if more else said)
