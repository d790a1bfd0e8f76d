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

Holds: rests in which a joint bears more than its friction can hold.

At rest, friction bears any torque up to what it takes in motion, and somewhat more before it breaks
away. Where a joint rests, and its drive presses by more than that beyond the load of its bodies,
something outside holds against it: a wall, a part, a hand. Where the drive bears less than the
load, a brake or a table may hold the arm, which no torque tells: that is no hold.

Source: Armstrong-Hélouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and
compensation methods for the control of machines with friction", Automatica 30(7), 1994, on the
ratio of friction as a joint breaks away to that in motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.noise import usual_error, usual_errors
from estimators.diagnosis.from_torque.residuals.pushes import Push, TimeSpan, covered, overlap
from estimators.diagnosis.from_torque.residuals.reversals import steadily_moving
from estimators.diagnosis.quantities import listed, rounded
from estimators.diagnosis.settings import FEW, LEVEL, MOST, NEARLY_ALL, OUTLYING, TINY
from estimators.diagnosis.settings.judgement import JOLTS, PUSHES, WORDING
from estimators.diagnosis.settings.residuals import ROWS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations
    from limo_driver.types import BoolArray, FloatArray


def holds(observed: Observations) -> tuple[Push, ...]:
    """Return the rests, in time, in which something outside holds against drives.

    None of a joint that rests so more often than not: there its load or its friction is another.

    Args:
        observed: Recordings, and a simulation that was fitted to their motion.
    """
    bare = observed.undisturbed(None).under(observed.simulation.without_friction())
    rests = [list(_rests(bare, joint)) for joint in range(bare.n)]
    if not any(rests):
        return ()
    friction = tuple(_friction(bare, joint) for joint in range(bare.n))
    rested = [x for joint, own in enumerate(rests) for x in _pressed(bare, joint, own, friction)]
    found: list[Push] = []
    for own in sorted(rested, key=lambda push: (push.recording, push.start)):
        last = found[-1] if found else None
        if last and last.recording == own.recording and own.start < last.end:
            surest = max(last, own, key=lambda push: push.evidence)
            joints = tuple(sorted({*last.joints, *own.joints}))
            end = max(last.end, own.end)
            found[-1] = replace(surest, start=last.start, end=end, joints=joints)
        else:
            found.append(own)
    return tuple(found)


def _friction(bare: Observations, joint: int) -> float:
    """Return what a joint (0-based) takes in motion on top of its bodies, at most [N m]."""
    beyond = np.abs(bare.residual[bare.moving[:, joint], joint])
    return float(np.quantile(beyond, LEVEL)) if beyond.size else np.inf


def _pressed(
    bare: Observations, joint: int, rests: Sequence[slice], friction: tuple[float, ...]
) -> list[Push]:
    """Return the rests of a joint (0-based) in which it bears more than friction can hold.

    Args:
        bare: Recordings, and the fitted simulation without its friction.
        joint: Which.
        rests: Its rows at rest.
        friction: Of each joint [N m].
    """
    residual, simulated = bare.residual[:, joint], bare.simulated[:, joint]
    usual = np.abs(residual[bare.moving[:, joint]])
    scatter = usual_error(usual - np.median(usual)) if usual.size else np.inf
    time, found = bare.slow.time, []
    for rows in rests:
        beyond = abs(float(np.median(residual[rows])))
        load, borne = (np.median(np.abs(x[rows])) for x in (simulated, bare.measured[:, joint]))
        if load < borne and beyond > 2 * friction[joint] and _is_passed(bare, rows):
            sure = 0.5 * ((beyond - friction[joint]) / scatter) ** 2
            start, end = time[rows][0] - 1 / bare.bandwidth, time[rows][-1]
            span = int(bare.recording[rows.start]), float(start), float(end)
            found.append(Push(*span, sure, (joint,), sure, held=True, friction=friction))
    return found if 2 * len(found) <= max(len(rests), 2) else []


def _is_passed(bare: Observations, rows: slice) -> bool:
    """Say whether the arm moves about where it rests, at other times: else its load is guessed."""
    position, time = bare.motion.position[bare.kept], bare.slow.time
    near = (time > time[rows][0] - PUSHES.apart) & (time < time[rows][-1] + PUSHES.apart)
    near &= bare.recording == bare.recording[rows.start]
    passed, rest = position[bare.moving.any(axis=1) & ~near], np.median(position[rows], axis=0)
    if not len(passed):
        return False
    low, high = passed.min(axis=0) - ROWS.travel, passed.max(axis=0) + ROWS.travel
    return bool(np.all((low <= rest) & (rest <= high)))


def _rests(bare: Observations, joint: int) -> Iterator[slice]:
    """Yield the rows of each rest of a joint (0-based) that is long enough to be one."""
    still = np.abs(bare.motion.velocity[bare.kept, joint]) < bare.sign_width[joint]
    if bare.unmeasured is not None:
        still &= ~bare.unmeasured[:, joint]
    # what belongs together: rows at rest, of one segment
    label = np.where(still, bare.segment + 1, 0)
    edges = np.flatnonzero(np.diff(label, prepend=0, append=0))
    time = bare.slow.time
    for first, last in pairwise(edges):
        if label[first] and time[last - 1] - time[first] >= PUSHES.apart:
            yield slice(int(first), int(last))


@dataclass(frozen=True)
class Jolt(TimeSpan):
    """When the arm was jolted, in the time of one recording."""

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
    known = steady.sum(axis=0) >= PUSHES.fewest
    usual = usual_errors(residual, steady)
    errors = np.where(
        steady & known, np.abs(residual) / np.maximum(usual, observed.least_noise), 0.0
    )
    large = errors > OUTLYING
    rows = np.flatnonzero(large.sum(axis=1) > 1)
    if not rows.size or rows.size > JOLTS.most * np.count_nonzero(steady.any(axis=1)):
        return ()
    time, recording = observed.slow.time[rows], observed.recording[rows]
    apart = (np.diff(time) > PUSHES.ends) | (np.diff(recording) != 0)
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
    times = [f"{event.start:.1f} s" for event in found[: WORDING.listed]]
    more = len(found) - len(times)
    return listed([*times, f"{more} other time{'s' * (more > 1)}"] if more else times)


@dataclass(frozen=True)
class Impact(TimeSpan):
    """When a link may have been caught after a fall across play, in the time of one recording."""

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
    if len(events) <= 1 or observed.n < FEW:
        return ()
    observed = observed.undisturbed(None)
    usual = np.maximum(usual_errors(residual, observed.moving), observed.least_noise)
    usual[~observed.moving.any(axis=0)] = np.inf
    errors = residual / usual
    explained = np.array([_explained(observed, errors, usual, event) for event in events])
    explained[explained < MOST] = 0.0
    explained *= np.array([_load_changes(observed, event) for event in events])
    joints = np.full(len(events), -1)
    while True:  # one joint after the other, first the one that explains most
        explained *= np.sum(explained > NEARLY_ALL, axis=0) > 1
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
    column /= np.maximum(np.linalg.norm(column, axis=1, keepdims=True), TINY)
    along = np.einsum("jik,ki->jk", column, left)
    return np.asarray(np.sum(along**2, axis=1) / max(float(np.sum(left**2)), TINY**2))


def _load_changes(observed: Observations, event: TimeSpan) -> BoolArray:
    """Mark the joints (n,) whose load changes sign in an event, or the fall before it."""
    time = observed.slow.time
    near = (observed.recording == event.recording) & (time > event.start - PUSHES.longest / 2)
    near &= time < event.end + observed.row_period
    load = observed.load[observed.kept][near]
    return np.asarray((load > 0).any(axis=0) & (load < 0).any(axis=0))
