"""Rows that say nothing new: values that were held, gaps, and velocities that are no derivative.

Held values: stretches over which a sensor repeats one value although its joint moves.

A torque sensor at its limit, a lost packet or a driver that hangs all give values that look fine
one by one. What tells is that they are exactly equal for longer than the sensor's noise allows.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from limo_driver.recordings.channels import Columns
    from limo_driver.types import BoolArray, FloatArray, IntArray

FEWEST = 10  # samples; fewer equal ones are no news
SHORTEST = 0.05  # [s]; the filters read over less
LEAST_JUMP = 2e-3  # [rad], with which a position that was held catches up
FASTER = 3.0  # times the fastest motion that such a jump is
LATEST = 0.3  # [s], in which a joint follows a command that steps
MOST_ACCELERATION = 100.0  # [rad/s²], of joints of arms
_ALIKE = 0.5  # of a command's swing, that friction lets it have in another rest
_MOVED = 5e-4  # [rad] within a run; less is noise
_NEAR = 0.05  # [s] from a limit, where noise is cut on one side
_CHANCE = 1e-9  # that noise repeats a value for as long anywhere in a recording
_LEAST_SHARE = 0.01  # of samples that equal the one before
_MOST_SHARE = 0.5  # above, the sensor is slower than the log or coarser than its noise
_ALTERNATING = 0.5  # part of third differences that change sign; 0.77 in noise, none in smooth data
LONGEST_STEP = 0.05  # [s]; motion within the bandwidth of an arm can be interpolated over less
LONGEST_STEP_PERIODS = 3.0  # [sample periods], for slow recordings
_AROUND = 5  # samples before and after a jump, whose steps are the joint's own motion
_SWUNG = 0.02  # [rad], range of a joint whose velocity can be judged
_ONE = 0.05  # of a factor, by which it is the same at all joints
_OFF_ALL = (0.005, 0.04)  # spread over joints and offset that no filter makes: it damps fast ones
_OFF = (0.2, 1.6)  # of its logarithm, from where no filter makes it, to where units do
_SWEEP = 0.1  # [s] over which velocity and change of position are compared


def held_torque(time: FloatArray, position: FloatArray, torque: FloatArray) -> BoolArray:
    """Mark samples at which a torque is held or saturated although its joint moves.

    Channels without noise, or coarser than it, are not judged: those may well repeat a value.

    Args:
        time: (T,) [s].
        position: (T,) [rad], of one joint.
        torque: (T,) [N m], of the same joint.

    Returns:
        (T,) true where the torque says nothing.
    """
    from scipy.ndimage import maximum_filter1d  # slow to import, and a live stream needs it not

    held = np.zeros(time.size, dtype=bool)
    starts, stops = _runs(torque)
    if (stops - starts).max(initial=0) < FEWEST:
        return held
    usual = np.repeat(stops - starts < FEWEST, stops - starts)
    share = float(np.mean(np.diff(torque)[usual[1:]] == 0)) if usual[1:].any() else 1.0
    if share > _MOST_SHARE or not _is_noisy(torque[usual]):
        return held
    longest = max(FEWEST, np.log(_CHANCE / time.size) / np.log(max(share, _LEAST_SHARE)))
    for k in np.flatnonzero(stops - starts >= longest):
        rows = slice(starts[k], stops[k])
        lasts = time[rows][-1] - time[rows][0]
        held[rows] = lasts >= SHORTEST and np.ptp(position[rows]) > _MOVED
    reach = 2 * round(_NEAR / float(np.median(np.diff(time)))) + 1
    for limit in (torque.min(), torque.max()):
        at_limit = torque == limit
        if held[at_limit].any():  # the limit cuts noise also around and on shorter visits
            held |= maximum_filter1d(at_limit, reach)
    return held


def held_position(
    time: FloatArray, position: FloatArray, command: FloatArray | None = None
) -> BoolArray:
    """Mark samples at which a position is held although its joint moves.

    A joint at rest repeats its value too, but does not jump when it starts: unless it was told to
    rest, and then to be elsewhere, or friction held it until it broke away.

    Args:
        time: (T,) [s].
        position: (T,) [rad], of one joint.
        command: Its set-points, (T,) [rad], where they were recorded.

    Returns:
        (T,) true from the second sample of each stretch to its last.
    """
    held = np.zeros(time.size, dtype=bool)
    starts, stops = _runs(position)
    starts, stops = starts[:-1], stops[:-1]  # the last ends with the recording
    if starts.size < 2:  # noqa: PLR2004  # a stretch lies between two changes
        return held
    jump = np.abs(position[stops] - position[stops - 1])
    speed = jump / np.maximum(time[stops] - time[stops - 1], 1e-9)
    caught_up = (stops - starts >= FEWEST) & (jump > LEAST_JUMP)
    caught_up &= speed > FASTER * speed.max(initial=0.0, where=~caught_up)
    if command is not None and caught_up.any():
        # Whether friction may have held a joint over runs of rows, until it broke away, (K,)
        away = np.abs(position[stops] - position[stops - 1])
        reach = 0.25 * MOST_ACCELERATION * (time[stops] - time[stops - 1]) ** 2
        behind = stops[-1]  # runs follow one another without a gap
        swing = np.maximum.reduceat(command[:behind], starts) - np.minimum.reduceat(
            command[:behind], starts
        )
        second, most = np.sort(swing)[-2:]
        other = np.where(swing == most, second, most)
        caught_up &= ~((away < reach) & ((starts == 0) | (other > _ALIKE * swing)))
    for k in np.flatnonzero(caught_up):
        first, stop = int(starts[k]), int(stops[k])
        held[first + 1 : stop] = command is None or not _rests(time, command, first, stop)
    return held


@np.errstate(over="ignore")  # of steps that no clock makes
def near_jumps(time: FloatArray, position: FloatArray) -> BoolArray:
    """Mark samples on both sides of jumps of a position, (T,), as many as make a gap.

    Rows were lost there and their times closed up, or poses were recorded one after the other: from
    one row to the next the joint goes farther than its own motion and any acceleration lets it, and
    stays there.

    Args:
        time: Increasing, (T,) [s].
        position: (T,) [rad], of one joint.
    """
    marked = np.zeros(time.size, dtype=bool)
    steps, size = np.diff(time), np.abs(np.diff(position))
    if not size.any():
        return marked
    period, gap, speed = float(np.median(steps)), longest_step(steps), size / steps
    reach = LEAST_JUMP + MOST_ACCELERATION * np.maximum(steps, period) ** 2
    least = np.maximum(reach, FASTER * float(np.median(size[size > 0])))  # no step of an encoder
    for k in np.flatnonzero((size > least) & (steps <= gap)):
        around = np.append(speed[max(k - _AROUND, 0) : k], speed[k + 1 : k + 1 + _AROUND])
        farther = np.append(speed[max(k - 3 * _AROUND, 0) : k], speed[k + 1 : k + 1 + 3 * _AROUND])
        own = max(
            FASTER * around.max(initial=0.0) * max(float(steps[k]), period),
            2 * _AROUND * period * float(np.median(farther)),  # a few rows that were held
        )
        before, after = position[max(k - 2, 0) : k + 1], position[k + 1 : k + 4]
        stays = abs(float(np.median(after) - np.median(before))) > size[k] / 2
        if stays and size[k] > own + reach[k]:
            marked |= np.abs(time - (time[k] + time[k + 1]) / 2) <= (gap + steps[k]) / 2
    return marked


def held_reason(j: int) -> str:
    """Return why rows are left out in which a joint's position is held.

    Args:
        j: The joint, 0-based.
    """
    return f"position_{j + 1} repeats a value while the joint moves"


def _rests(time: FloatArray, command: FloatArray, first: int, stop: int) -> bool:
    """Say whether a joint is told to rest over a stretch of rows, but at its end."""
    last = int(np.searchsorted(time, time[stop] - LATEST, "right"))
    return last > first + 1 and float(np.ptp(command[first:last])) < LEAST_JUMP


def _runs(values: FloatArray) -> tuple[IntArray, IntArray]:
    """Return first and past-the-end samples of each run of equal values."""
    changes = np.flatnonzero(np.diff(values)) + 1
    return np.append(0, changes), np.append(changes, values.size)


def _is_noisy(values: FloatArray) -> bool:
    """Say whether neighbours differ by noise rather than by motion."""
    third = np.diff(values, n=3)
    third = third[third != 0]
    return third.size > FEWEST and float(np.mean(third[1:] * third[:-1] < 0)) > _ALTERNATING


def contiguous(time: FloatArray) -> tuple[slice, ...]:
    """Split increasing times (T,) [s] at the gaps."""
    if time.size == 0:
        return ()
    steps = np.diff(time)
    ends = np.flatnonzero(steps > longest_step(steps)) + 1
    bounds = [0, *ends.tolist(), time.size]
    return tuple(slice(a, b) for a, b in pairwise(bounds))


def even_runs(time: FloatArray) -> list[slice]:
    """Split times (T,) [s] where they do not increase, and at the gaps."""
    steps = np.diff(time)
    breaks = np.flatnonzero((steps <= 0) | (steps > longest_step(steps))) + 1
    return [slice(a, b) for a, b in pairwise([0, *breaks.tolist(), time.size])]


def longest_step(steps: FloatArray) -> float:
    """Return the longest step that is no gap [s], by the steps of time (T - 1,) [s]."""
    forward = steps[steps > 0]
    period = float(np.median(forward)) if forward.size else LONGEST_STEP
    return max(LONGEST_STEP, LONGEST_STEP_PERIODS * period)


def velocity_factor(time: FloatArray, position: FloatArray, velocity: FloatArray) -> float | None:
    """Return velocity over rate of change of position, by least squares; None if nothing moves.

    All are (T,), of one joint. Sums over stretches are compared, since a difference quotient of
    close samples is all noise.
    """
    step = np.diff(time)
    swept = (velocity[1:] + velocity[:-1]) / 2 * step
    known = np.isfinite(swept) & (step < longest_step(step))
    period = float(np.median(step))
    if not (known.any() and period > 0):
        return None
    stride = max(1, round(min(_SWEEP / period, step.size)))
    starts = np.arange(0, step.size, stride)
    says = np.add.reduceat(np.where(known, swept, 0.0), starts)
    does = np.add.reduceat(np.where(known, np.diff(position), 0.0), starts)
    energy = float(does @ does)
    return float(says @ does) / energy if energy > 0 else None


def one_factor(factors: FloatArray) -> float | None:
    """Return the factor by which the velocities of all joints are off alike; None if none is.

    Args:
        factors: Of velocity over rate of change, (n,); NaN of joints that rest.
    """
    known = np.abs(factors[np.isfinite(factors)])
    if known.size < min(factors.size, 2) or not known.all() or not known.size:
        return None
    factor = float(np.median(known))
    spread = float(np.abs(np.log(known / factor)).max())
    least = _OFF_ALL[1] if spread < _OFF_ALL[0] and known.size > 1 else _OFF[0]
    return factor if spread < _ONE and least < abs(np.log(factor)) < _OFF[1] else None


def swept(columns: Columns, rows: IntArray, joint: int) -> float:
    """Return the range of motion in a recorded velocity, without drift [rad]; 0 if none is."""
    if columns.velocity is None:
        return 0.0
    velocity = np.nan_to_num(columns.velocity[rows, joint])
    path = np.cumsum((velocity - velocity.mean()) * np.gradient(columns.time[rows]))
    return float(np.ptp(path))


def velocity_factors(columns: Columns, rows: IntArray) -> dict[int, float]:
    """Return how many times the rate of change of position each moving joint's velocity is."""
    if columns.velocity is None:
        return {}
    position = columns.position[rows]
    swings = np.ptp(position, axis=0) > _SWUNG
    factors = factors_by_joint(columns.time[rows], position, columns.velocity[rows], swings)
    return {int(j): float(factors[j]) for j in np.flatnonzero(np.isfinite(factors))}


def factors_by_joint(
    time: FloatArray, position: FloatArray, velocity: FloatArray, moves: BoolArray
) -> FloatArray:
    """Return velocities over rates of change of positions, (n,); NaN of joints that rest.

    Noise of a joint that rests has a factor of its own, which says nothing of units.

    Args:
        time: (T,) [s].
        position: (T, n).
        velocity: (T, n).
        moves: Which joints do, (n,).
    """
    own = zip(position.T, velocity.T, moves, strict=True)
    found = [velocity_factor(time, q, v) if moving else None for q, v, moving in own]
    return np.array(found, dtype=float)
