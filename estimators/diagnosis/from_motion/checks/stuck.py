"""A joint that rests for long while its command moves by more than friction can hold.

Where it then moves on as fast as no joint does, its rows were left out of the recording: a joint
that is stalled and let go looks there like an encoder that hangs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.recordings.gate import held_reason

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

AT_REST: Final = 0.002  # [rad] that a joint moves less than where it rests
_SWING: Final = 0.1  # [rad] of command, that friction of a servo in order hardly holds
_TIMES: Final = 2.0  # what friction holds elsewhere in the recording, that it has to exceed
_LONG: Final = 0.5  # [s], beside which a command that acts late is short
_LATE: Final = 0.3  # [s] at the end of a rest, in which a command has moved that acts later


def stuck(
    time: FloatArray, command: FloatArray, position: FloatArray
) -> tuple[float, float, float]:
    """Return from when to when a joint is stuck [s], and how far its command moves then [rad].

    Dry friction holds each joint until its servo's torque exceeds it: by how much a command moves
    before, every rest of the joint shows. A stuck one rests while its command moves further.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        First and last time, and swing; a swing of 0 if it is not.
    """
    swings = list[tuple[float, float, float, float]]()
    for start, stop in _rests(position):
        last = int(np.searchsorted(time, time[stop - 1] - _LATE, "right"))
        if last - start > 1:
            lasting = float(time[last - 1] - time[start])
            ends = float(time[start]), float(time[stop - 1])
            swings.append((float(np.ptp(command[start:last])), lasting, *ends))
    if not swings:
        return 0.0, 0.0, 0.0
    swing, lasting, since, until = max(swings)
    usual = sorted(own for own, *_ in swings)[-2] if len(swings) > 1 else 0.0
    is_stuck = lasting > _LONG and swing > max(_SWING, _TIMES * usual)
    return (since, until, swing) if is_stuck else (0.0, 0.0, 0.0)


def resting_around(time: FloatArray, position: FloatArray, rows: slice) -> tuple[float, float]:
    """Return from when to when a joint rests that does so over some rows [s].

    Args:
        time: (T,) [s].
        position: (T,) [rad].
        rows: Within which it rests.
    """
    middle = float(np.ptp(position[rows]) / 2.0 + position[rows].min())
    away = np.flatnonzero(np.abs(position - middle) > AT_REST)
    k = int(np.searchsorted(away, rows.start))
    first = int(away[k - 1]) + 1 if k else 0
    last = int(away[k]) - 1 if k < away.size else time.size - 1
    return float(time[first]), float(time[last])


def left_out_at_rest(recording: Recording, j: int, name: str) -> Iterator[str]:
    """Yield that a recording lacks rows as a joint rested in them, and then jumped.

    Args:
        recording: With commands.
        j: The joint, 0-based.
        name: Of the recording.
    """
    assert recording.rows is not None  # noqa: S101  # set as it is made
    lost = [row for out in recording.left_out if out.reason == held_reason(j) for row in out.rows]
    behind = np.unique(np.searchsorted(recording.rows, np.array(lost, dtype=np.int64)))
    for k in behind[(behind > 0) & (behind < len(recording))].tolist():
        since, until = map(float, recording.time[k - 1 : k + 1])
        if until - since > _LATE:
            jump = abs(float(recording.position[k, j] - recording.position[k - 1, j]))
            yield (
                f"joint {j + 1} is stalled, or its encoder hangs: its position repeats a value "
                f"while its command moves on, and then jumps by {jump:.2f} rad; these rows are "
                f"left out ({name}, {from_to(since, until)})"
            )


def from_to(since: float, until: float) -> str:
    """Return two times [s] in words."""
    return f"{since:.1f} s to {until:.1f} s"


def _rests(position: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the first row, and the one behind the last, of stretches in which a joint rests."""
    start, low, high = 0, position[0], position[0]
    for i, value in enumerate(position):
        low, high = min(low, value), max(high, value)
        if high - low >= AT_REST:
            yield start, i
            start, low, high = i, value, value
    yield start, position.size
