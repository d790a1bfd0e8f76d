"""A joint that rests for long while its command moves by more than friction can hold."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from limo_driver.types import FloatArray

AT_REST: Final = 0.002  # [rad] that a joint moves less than where it rests
_SWING: Final = 0.1  # [rad] of command, that friction of a servo in order hardly holds
_TIMES: Final = 2.0  # what friction holds elsewhere in the recording, that it has to exceed
_LONG: Final = 1.0  # [s]
_LATE: Final = 0.3  # [s] at the end of a rest, in which a command has moved that acts later


def stuck(time: FloatArray, command: FloatArray, position: FloatArray) -> tuple[float, float]:
    """Return since when a joint is stuck [s], and how far its command moves meanwhile [rad].

    Dry friction holds each joint until its servo's torque exceeds it: by how much a command moves
    before, every rest of the joint shows. A stuck one rests while its command moves further.

    Args:
        time: (T,) [s].
        command: (T,) [rad].
        position: (T,) [rad].

    Returns:
        Time and swing; a swing of 0 if it is not.
    """
    swings = list[tuple[float, float, float]]()
    for start, stop in _rests(position):
        last = int(np.searchsorted(time, time[stop - 1] - _LATE, "right"))
        if last - start > 1:
            lasting = float(time[last - 1] - time[start])
            swings.append((float(np.ptp(command[start:last])), lasting, float(time[start])))
    if not swings:
        return 0.0, 0.0
    swing, lasting, since = max(swings)
    usual = sorted(own for own, *_ in swings)[-2] if len(swings) > 1 else 0.0
    is_stuck = lasting > _LONG and swing > max(_SWING, _TIMES * usual)
    return (since, swing) if is_stuck else (0.0, 0.0)


def _rests(position: FloatArray) -> Iterator[tuple[int, int]]:
    """Yield the first row, and the one behind the last, of stretches in which a joint rests."""
    start, low, high = 0, position[0], position[0]
    for i, value in enumerate(position):
        low, high = min(low, value), max(high, value)
        if high - low >= AT_REST:
            yield start, i
            start, low, high = i, value, value
    yield start, position.size
