"""Frames that were dropped: rows that are missing, whether or not times of the others say so."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from estimators.diagnosis.from_motion.simulation.free_run import commands_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_LEAP: Final = 1.6  # times the pace of the rows around, at which joints reach a row
_STEADY: Final = 4.0  # times what paces before and behind a leap differ by, that it has to exceed
_AROUND: Final = 2  # rows before a leap and behind it, that have to agree
_TICKS: Final = 4.0  # of an encoder, that joints together have to move in a row
_FEW: Final = 3  # rows, from which on frames are missing
_LATE: Final = 1.6  # periods between two rows, from which on one between them is missing
_EVEN: Final = 0.2  # of a period, by which most rows may come early or late where some are missing
_JUMP: Final = 3.0  # times the fastest elsewhere, at which no arm moves
_JUMPED: Final = 0.02  # [rad], least that a joint moves at once where many rows are missing
_TOGETHER: Final = 0.5  # of what joints jump, that their commands do in the same row
_PAST: Final = 2.0  # [s], in which a servo in order has come to where it was told
_NEAR, _AWAY = 0.1, 0.3  # [rad] beyond the commands of that time: where it begins, and is sure
_MOVED: Final = 0.15  # [rad], by which the joint itself has moved meanwhile


def dropped_frames(recording: Recording, name: str) -> Iterator[str]:
    """Yield what says that frames were dropped, if anything does.

    Args:
        recording: With commands.
        name: Of the recording, as it is told.
    """
    time = recording.time
    if (late := _late(recording)).size >= _FEW:
        yield (
            f"rows are missing: {late.size} times the next one came two periods later or more "
            f"({name}, first at {time[late[0]]:.1f} s)"
        )
    if len(rows := _leaps(recording)) >= _FEW:
        yield (
            f"in {len(rows)} rows joints move much further than in the rows around; "
            f"were frames dropped and the others stamped evenly? ({name}, first at "
            f"{time[rows[0]]:.1f} s)"
        )
    elif (row := _jump(recording)) is not None:
        yield (
            f"joints and their commands jump within one row, faster than anywhere else; were many "
            f"frames dropped and the others stamped evenly? ({name}, {time[row]:.1f} s)"
        )


def _late(recording: Recording) -> NDArray[np.intp]:
    """Return the rows behind which one or two are missing, by even times of the others.

    More of them are a gap, which is told as one; rows that were left out are not missing.
    """
    steps = np.diff(recording.time)
    period = float(np.median(steps))
    if float(np.percentile(np.abs(steps - period), 90)) > _EVEN * period:
        return np.array([], dtype=np.intp)
    left_out = [row for item in recording.left_out for row in item.rows]
    given = np.setdiff1d(np.arange(len(recording) + len(left_out)), left_out)
    return np.flatnonzero((steps > _LATE * period) & (np.diff(given) == 1))


def _jump(recording: Recording) -> int | None:
    """Return the row at which the arm and its commands are elsewhere at once, if there is one.

    A command that steps is followed later. Where all joints that move are elsewhere in the same row
    as their commands, time is amiss: two of them at least, if two ever move.
    """
    position, command, time = recording.position, commands_of(recording), recording.time
    row = int(np.argmax(np.linalg.norm(_paces(position, time), axis=1)))
    moved, told = (x[row + 1] - x[row] for x in (position, command))
    jumped = (
        _fastest(position, time, row)
        & _fastest(command, time, row)
        & (told * moved > _TOGETHER * moved**2)
        & (np.abs(moved) > _JUMPED)
    )
    least = min(2, int((np.ptp(position, axis=0) > _JUMPED).sum()))
    return row + 1 if 0 < least <= int(jumped.sum()) else None


def _paces(values: FloatArray, time: FloatArray) -> FloatArray:
    """Return how fast joints move to each next row, (T - 1, n) [rad/s]."""
    return np.abs(np.diff(values, axis=0) / np.diff(time)[:, None])


def _fastest(values: FloatArray, time: FloatArray, row: int) -> NDArray[np.bool_]:
    """Say which joints move much faster behind a row than anywhere else, (n,)."""
    pace = _paces(values, time)
    return pace[row] > _JUMP * np.delete(pace, row, axis=0).max(axis=0, initial=0.0)


def _leaps(recording: Recording) -> list[int]:
    """Return rows to which all joints leap, from a steady pace to the same one.

    No motor does that, nor a row that is read late: the next one would be short. Paces of all
    joints together are one vector; its change in a row is told in units of the encoders' steps.
    Steady is what two rows before and two behind agree on: a joint that speeds up and slows down
    within few rows, as all do at slow rates, is fastest in the middle, too.
    """
    step = np.diff(recording.position, axis=0)
    size = np.where(step == 0.0, np.inf, np.abs(step))
    ticks = np.percentile(size, 1, axis=0, method="lower")
    tick = float(np.median(ticks[np.isfinite(ticks)])) if np.isfinite(ticks).any() else 0.0
    period = np.diff(recording.time)[:, None]
    pace = step / period
    if len(pace) < 2 * _AROUND + 1:
        return []
    last = len(pace) - _AROUND
    here, least = pace[_AROUND:last], tick / period[_AROUND:last, 0]
    around = [pace[_AROUND + k : last + k] for k in (*range(-_AROUND, 0), *range(1, _AROUND + 1))]
    mean = np.mean(around, axis=0)
    length = np.linalg.norm(mean, axis=1)
    fast = length > _TICKS * least
    length = np.where(fast, length, 1.0)
    times = (here * mean).sum(axis=1) / length**2
    apart = np.max([np.linalg.norm(a - b, axis=1) for a, b in combinations(around, 2)], axis=0)
    uneven = np.maximum(apart - 2.0 * least, 0.0) / length
    leap = (times > _LEAP) & (times - 1.0 > _STEADY * uneven) & (uneven < 1.0)
    return (np.flatnonzero(leap & fast) + _AROUND).tolist()


def led_away(time: FloatArray, command: FloatArray, position: FloatArray) -> tuple[float, float]:
    """Return since when a joint is led away from its commands [s], and how far [rad].

    A servo lags, sags and swings; what it never does is leave the range of all that it was told in
    the last seconds by a lot, from near it, by moving itself.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        Time and distance; a distance of 0 if it is not.
    """
    rows = max(1, round(_PAST / float(np.median(np.diff(time)))))
    low, high = (
        of(command, rows + 1, origin=rows // 2, mode="nearest")
        for of in (minimum_filter1d, maximum_filter1d)
    )
    beyond = np.where(position > high, position - high, np.minimum(position - low, 0.0))
    near = -1
    for i, far in enumerate(beyond.tolist()):
        if abs(far) < _NEAR:
            near = i
        elif abs(far) > _AWAY and near >= 0:
            if np.sign(far) * (position[i] - position[near]) > _MOVED:
                return float(time[near]), float(np.abs(beyond[near : i + rows]).max())
            near = -1  # its command went away from it
    return 0.0, 0.0
