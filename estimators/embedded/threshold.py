"""The threshold of external torque that gives a stated rate of false alarms.

It counts in standard deviations of the model's error, and is found in one of two ways.

*Of recorded free motion.* Where nothing touches the arm, external torque is error. Each time it
rises above a level u and falls again, its largest value is a peak; peaks further apart than
1/bandwidth are taken for independent. With u so that K peaks lie above it, by b on average, in the
time T, the tail of an exponential distribution gives

    rate of alarms = (K / T) exp(-(k - u) / b)

for each joint, of which it has the n-th part of what is bearable. Errors peak at reversals, far
beyond what normal ones of the same size do, so this is the way to take.

*Without any.* Errors are taken for normal, with a spectrum up to the bandwidth B. They cross k of
their standard deviations upwards at most B exp(-k² / 2) times a second, on both sides:

    rate of alarms = 2 n B exp(-k² / 2)

Source: Coles, "An Introduction to Statistical Modeling of Extreme Values", 2001, ch. 4 and 5
(peaks over thresholds, declustering); Rice, "Mathematical analysis of random noise", Bell System
Technical Journal 24, 1945, sec. 3.3.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.stream import Stream
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_HOUR: Final = 3600.0  # [s]
_FEWEST: Final = 20  # peaks that a tail is fitted to
_PART: Final = 0.1  # of all peaks, that are tail


def normal_threshold(false_alarms: float, joints: int, bandwidth: float) -> FloatArray:
    """Return how many standard deviations normal errors reach as often, (n,).

    Args:
        false_alarms: Wanted of the whole arm [1/h].
        joints: Number n of joints.
        bandwidth: Of the filter on motion and torque [Hz].

    Raises:
        ConfigError: So many would be no rate of alarms, or more than there are crossings.
    """
    crossings = 2.0 * joints * bandwidth * _HOUR
    if not 0.0 < false_alarms < crossings:
        raise ConfigError(
            f"{false_alarms:g} false alarms an hour, expected above 0 and below {crossings:.3g}, "
            f"which {joints} joints behind {bandwidth:g} Hz give without any threshold"
        )
    return np.full(joints, math.sqrt(2.0 * math.log(crossings / false_alarms)))


def measured_threshold(
    false_alarms: float, stream: Stream, free: Sequence[Recording]
) -> FloatArray:
    """Return how many standard deviations the errors on free motion reach as often, (n,).

    Args:
        false_alarms: Wanted of the whole arm [1/h].
        stream: Of the model.
        free: Motion that nothing touched, and that the model was not trained on.

    Raises:
        ConfigError: The rate of alarms is not possible.
        RecordingError: A recording has another rate, or a joint's errors have too few peaks.
    """
    normal_threshold(false_alarms, stream.n, stream.model.bandwidth)  # refuses an impossible rate
    peaks: list[list[FloatArray]] = [[] for _ in range(stream.n)]
    known = np.zeros(stream.n)
    apart = math.ceil(stream.rate / stream.model.bandwidth)
    for recording in free:
        recording.check_robot(stream.model.simulation.model)  # pyright: ignore[reportAttributeAccessIssue]
        late, _ = stream.advance(
            stream.init(), recording.time, recording.position, recording.torque
        )
        if late.measured is None:
            continue
        usable = ~late.outside
        usable[: 2 * stream.samples] = False  # the filter fills
        size = np.where(usable, np.abs(late.measured - late.torque) / late.std, 0.0)
        known += usable.sum(axis=0) / stream.rate
        for j in range(stream.n):
            peaks[j].append(_peaks(size[:, j], apart))
    found = [np.concatenate(own) for own in peaks]
    for j, own in enumerate(found):
        if own.size < _FEWEST:
            raise RecordingError(
                f"joint {j + 1}: {own.size} peaks of the error where the model is sure, expected "
                f"at least {_FEWEST}; record free motion for longer, like that of the training"
            )
    wanted = false_alarms / _HOUR / stream.n
    return np.array([_level(own, time, wanted) for own, time in zip(found, known, strict=True)])


def _peaks(size: FloatArray, apart: int) -> FloatArray:
    """Return the largest value of each stretch of `apart` samples that is above its neighbours."""
    blocks = np.append(size, np.zeros(-size.size % apart)).reshape(-1, apart).max(axis=1)
    above: NDArray[np.bool_] = blocks > 0.0
    before, after = np.append(0.0, blocks[:-1]), np.append(blocks[1:], 0.0)
    return blocks[above & (blocks >= before) & (blocks > after)]


def _level(peaks: FloatArray, time: float, wanted: float) -> float:
    """Return the level that peaks in so much time [s] exceed at a rate [1/s]."""
    ordered = np.sort(peaks)[::-1]
    tail = max(_FEWEST - 1, math.ceil(_PART * ordered.size))
    u, mean = float(ordered[tail]), float(np.mean(ordered[:tail] - ordered[tail]))
    return u + mean * max(math.log(tail / time / wanted), 0.0)
