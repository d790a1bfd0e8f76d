"""Motion that is held out, errors there, and what a finding removes of them.

Errors that no feedback of the simulation adds to: of one step, and of inverse dynamics.

A free run from the commands alone adds up what is amiss. Here the joint is simulated from each
recorded row to the next, position and velocity as recorded; and the torque that its recorded
acceleration needs is compared with that of drive and friction there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation.free_run import commands_of, restarted_run
from estimators.diagnosis.from_motion.simulation.one_joint import RowErrors
from limo_driver.recordings.channels import TORQUE, VELOCITY, led_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.from_motion.simulation.one_joint import LoadedJoint
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

LEAST: Final = 1e-9
CONFIDENT: Final = 0.95  # share of resampled held-out motion in which a finding has to remove it
_SEEN: Final = 0.1  # of a joint's squared held-out error, that a finding has to remove at least
_MANY: Final = 4  # recordings, from which on whole ones are held out
_REST: Final = 0.1  # [s] before and after a cut, in which a joint moves little
_BLOCKS, _DRAWN = 20, 1000  # of what is held out at once, and resamples of them


def split(recordings: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Return what is fitted to and what is held out: every other recording, or halves of few.

    Recordings go by the speed of their commands, and the fastest is fitted to: slow motion does not
    show what limits a servo's speed, and predicts none of a fast one. Few recordings may each be of
    another kind of motion, and what one of them alone shows would never be proven by the others:
    each is cut in two, where its joints are slowest around its middle.
    """
    if len(recordings) >= _MANY:
        by_speed = sorted(recordings, key=_speed, reverse=True)
        return by_speed[0::2], by_speed[1::2]
    at = [_cut(recording) for recording in recordings]
    pairs = [(r[:middle], r[middle:]) for r, middle in zip(recordings, at, strict=True)]
    return [first for first, _ in pairs], [second for _, second in pairs]


def _cut(recording: Recording) -> int:
    """Return the row around the middle at which all joints are slowest."""
    third, half = len(recording) // 3, max(1, round(_REST * recording.rate))
    moved = np.abs(np.diff(recording.position, axis=0)).sum(axis=1)
    around = np.convolve(moved, np.ones(2 * half), mode="same")[third : 2 * third]
    return third + int(np.argmin(around)) if around.size else len(recording) // 2


def _speed(recording: Recording) -> float:
    """Return how fast commands move, as their root mean square [rad/s]; of torques, the joints."""
    pushed, command = led_by(TORQUE, recording.channels), commands_of(recording)
    moved = np.where(pushed, recording.position, command)
    change = np.diff(moved, axis=0) / np.diff(recording.time)[:, None]
    change = np.where(led_by(VELOCITY, recording.channels), command[:-1], change)
    return float(np.sqrt(np.mean(change**2)))


def position_errors(simulation: Simulation, recordings: Sequence[Recording]) -> FloatArray:
    """Return free-running position errors of all rows, (K, n) [rad].

    What is told no positions is put back where it was, as often as its drive asks for.
    """
    return np.concatenate([restarted_run(simulation, r) - r.position for r in recordings])


def rms_of_rows(
    parts: Sequence[Sequence[LoadedJoint]], rows: Sequence[FloatArray]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the RMS errors of one step (n,) [rad] and of inverse dynamics (n,) [N m].

    Args:
        parts: Held-out stretches of each joint.
        rows: Constants of each joint.
    """
    found = [row_errors(own, row) for own, row in zip(parts, rows, strict=True)]
    step, torque = (
        tuple(float(np.sqrt(np.mean(error**2))) for error in own)
        for own in ([x.step for x in found], [x.torque for x in found])
    )
    return step, torque


def removes(squared: FloatArray, without: FloatArray, folds: int = 1) -> float:
    """Return in which share of resampled motion a finding removes a tenth of the error, or more.

    Args:
        squared: Errors of the held-out rows with it, (K,) [rad²].
        without: The same without it.
        folds: Parts of the motion among the rows, that were held out in turn.
    """
    many, gain = _BLOCKS * folds, without - squared - _SEEN * without
    blocks = np.array([block.sum() for block in np.array_split(gain, many)])
    drawn = np.random.default_rng(0).integers(0, many, (_DRAWN, many))
    return min(0.99, float(np.mean(blocks[drawn].sum(axis=1) > 0.0)))


def resolution_of(recordings: Sequence[Recording], j: int) -> float:
    """Return the step of an encoder [rad]; 0 if it has none that shows.

    The least by which positions change from row to row; of a joint that is told velocities, the
    least between any two of them: a wheel turns on, and by many steps of its encoder in each row.
    """
    rows = [
        np.sort(r.position[:, j]) if r.channels[j] == VELOCITY.name else r.position[:, j]
        for r in recordings
    ]
    steps = np.concatenate([np.abs(np.diff(values)) for values in rows])
    steps = steps[steps > LEAST]
    return float(np.percentile(steps, 1)) if steps.size else 0.0


def by_recording(
    before: FloatArray, after: FloatArray, rows: Sequence[int], floor: FloatArray
) -> tuple[float, float]:
    """Return the 95 % interval of what is removed, from resampled recordings held out."""
    bounds = np.cumsum([0, *rows])
    gain = np.add.reduceat((before**2 - after**2).sum(axis=1), bounds[:-1])
    reducible = np.add.reduceat((before**2 - floor**2).sum(axis=1), bounds[:-1])
    drawn = np.random.default_rng(0).integers(0, len(rows), (1000, len(rows)))
    share = gain[drawn].sum(axis=1) / np.maximum(reducible[drawn].sum(axis=1), LEAST)
    low, high = np.percentile(share, (2.5, 97.5))
    return float(low), float(high)


def row_errors(parts: Sequence[LoadedJoint], row: FloatArray) -> RowErrors:
    """Return the errors of a joint from each recorded row on.

    Args:
        parts: Recorded stretches.
        row: The constants of the joint.
    """
    found = [part.errors_of_rows(row) for part in parts]
    return RowErrors(*(np.concatenate(own) for own in zip(*found, strict=True)))
