"""Holds: rests in which a joint bears more than its friction can hold.

At rest, friction bears any torque up to what it takes in motion, and somewhat more before it breaks
away. Where a joint rests, and its drive presses by more than that beyond the load of its bodies,
something outside holds against it: a wall, a part, a hand. Where the drive bears less than the
load, a brake or a table may hold the arm, which no torque tells: that is no hold.

Source: Armstrong-Hélouvry, Dupont and Canudas de Wit, "A survey of models, analysis tools and
compensation methods for the control of machines with friction", Automatica 30(7), 1994, on the
ratio of friction as a joint breaks away to that in motion.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.from_torque.residuals.noise import usual_error
from estimators.diagnosis.from_torque.residuals.pushes import Push
from estimators.diagnosis.settings.pushes import PUSHES
from estimators.diagnosis.settings.residuals import ROWS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from estimators.diagnosis.from_torque.residuals.observations import Observations


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
    return float(np.quantile(beyond, PUSHES.friction)) if beyond.size else np.inf


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
        if load < borne and beyond > PUSHES.breakaway * friction[joint] and _is_passed(bare, rows):
            sure = 0.5 * ((beyond - friction[joint]) / scatter) ** 2
            start, end = time[rows][0] - ROWS.near_rest / bare.bandwidth, time[rows][-1]
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
        if label[first] and time[last - 1] - time[first] >= PUSHES.rests:
            yield slice(int(first), int(last))
