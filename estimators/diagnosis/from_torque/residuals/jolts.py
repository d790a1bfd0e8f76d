"""Jolts: short stretches in which errors of several joints are far larger than usual at once.

A controller that stalls for some milliseconds, or a brake, makes an arm ring at frequencies that no
slow physics reaches; a part of the log that is missing looks much the same. Half a second of that
may double the noise of a whole recording, and hide all that is smaller. So nothing is fitted to
those rows, nor to those to which the filter spreads them, and a note says when they are. Joints
that start, stop or turn do not count: what friction does there is physics.

Impacts: what play does as a link is caught, which is no push and no jolt.

Where the load of a joint changes sign, its link falls across the play, and is caught on the other
flank. The link is accelerated and its drive is not, so the torques of all joints err as the
acceleration of this one joint alone asks of them: at each moment by a column of the mass matrix.
Somebody's force acts on joints by its levers, which stand in these ratios by chance only, and
hardly twice as the load of the same joint has changed.

How a flank catches a link, and how it swings there, no law of play says that a fit could follow. So
nothing is fitted to those rows either; play shows in all others, too.

Source: Nordin and Gutman, "Controlling mechanical systems with backlash - a survey", Automatica
38(10), 2002.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.noise import usual_errors
from estimators.diagnosis.from_torque.residuals.pushes import covered, overlap
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from estimators.diagnosis.quantities import listed, rounded
from estimators.diagnosis.settings.pushes import IMPACTS, JOLTS, PUSHES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from estimators.diagnosis.from_torque.residuals.pushes import TimeSpan
    from limo_driver.types import FloatArray

_TINY = float(np.finfo(float).tiny)


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


def jolts_note(found: Sequence[Jolt], recordings: int) -> str:
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


@dataclass(frozen=True)
class Impact:
    """When a link may have been caught after a fall across play, in the time of one recording."""

    recording: int  # 0-based
    start: float  # [s]
    end: float  # [s]
    joint: int  # 0-based


def impacts(
    observed: Observations, residual: FloatArray, events: Sequence[TimeSpan]
) -> tuple[Impact, ...]:
    """Return those of some events that are what play of one joint does again and again.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        residual: What a fit leaves, (K, n) [N m].
        events: Stretches in which errors are far larger than usual.
    """
    if len(events) < IMPACTS.fewest or observed.n < IMPACTS.joints:
        return ()
    observed = observed.undisturbed(None)
    usual = np.maximum(usual_errors(residual, observed.moving), observed.least_noise)
    usual[~observed.moving.any(axis=0)] = np.inf
    errors = residual / usual
    explained = np.array([_explained(observed, errors, usual, event) for event in events])
    explained[explained < IMPACTS.alike] = 0.0
    explained *= np.array([_load_changes(observed, event) for event in events])
    joints = np.full(len(events), -1)
    while True:  # one joint after the other, first the one that explains most
        explained *= np.sum(explained > IMPACTS.explained, axis=0) >= IMPACTS.fewest
        joint = int(np.argmax(explained.sum(axis=0)))
        own = explained[:, joint] > 0.0
        if not own.any():
            break
        joints[own], explained[own] = joint, 0.0
    return tuple(
        Impact(event.recording, event.start, event.end, joint)
        for event, joint in zip(events, joints.tolist(), strict=True)
        if joint >= 0
    )


def impacts_note(found: Sequence[Impact], recordings: int) -> str:
    """Say when links may have been caught.

    Args:
        found: The impacts, at least one.
        recordings: How many there are; which one it is goes without saying where there is one.
    """
    found = sorted(found, key=lambda impact: (impact.recording, impact.start))
    joints = sorted({impact.joint + 1 for impact in found})
    return (
        f"At {times_of(found, recordings)} the errors of all joints are those of an acceleration "
        f"of joint {' or '.join(map(str, joints))} alone, whose load has just changed sign: as "
        "where its link has fallen across play, and is caught. What lies within "
        f"{PUSHES.spread:g} s of that is neither fitted nor judged."
    )


def _explained(
    observed: Observations, errors: FloatArray, usual: FloatArray, event: TimeSpan
) -> FloatArray:
    """Return the part of squared errors in and around an event that each joint explains, (n,).

    By its acceleration alone, beyond the levels between which errors pass: gravity is another once
    a link has fallen.

    Args:
        observed: Recordings and simulation, K slow rows of n joints.
        errors: Over what is usual of each joint, (K, n).
        usual: What is, (n,) [N m].
        event: When.
    """
    near = covered(observed, (event,))
    time = observed.slow.time[near] - event.start
    passed = np.clip(time / max(event.end - event.start, observed.row_period), 0.0, 1.0)
    levels = np.stack([np.ones_like(passed), passed], axis=1)
    left = errors[near] - levels @ np.linalg.lstsq(levels, errors[near])[0]
    column = observed.inertia[:, :, near] / usual[:, None]
    column /= np.maximum(np.linalg.norm(column, axis=1, keepdims=True), _TINY)
    along = np.einsum("jik,ki->jk", column, left)
    return np.asarray(np.sum(along**2, axis=1) / max(float(np.sum(left**2)), _TINY))


def _load_changes(observed: Observations, event: TimeSpan) -> NDArray[np.bool_]:
    """Mark the joints (n,) whose load changes sign in an event, or the fall before it."""
    time = observed.slow.time
    near = (observed.recording == event.recording) & (time > event.start - IMPACTS.fall)
    near &= time < event.end + observed.row_period
    load = observed.load[observed.kept][near]
    return np.asarray((load > 0).any(axis=0) & (load < 0).any(axis=0))
