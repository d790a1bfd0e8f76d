"""The threshold of external torque that gives a stated rate of false alarms.

It counts in standard deviations of the model's error, and is found of recorded free motion: where
nothing touches the arm, external torque is error. Each time it rises above a level u and falls
again, its largest value is a peak; peaks further apart than 1/bandwidth are taken for independent.
With u so that K peaks lie above it, by b on average, in the time T, the tail of an exponential
distribution gives

    rate of alarms = (K / T) exp(-(k - u) / b)

for each joint, of which it has the n-th part of what is bearable. A model that knows no errors, as
a simulation alone, is given the RMS of those on that motion. Without any, no code of contact is
written: errors peak at reversals, far beyond what normal ones of the same size do.

Source: Coles, "An Introduction to Statistical Modeling of Extreme Values", 2001, ch. 4 and 5
(peaks over thresholds, declustering).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from estimators.stream import Stream
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

FALSE_ALARMS: Final = 1.0  # [1/h]
TURNED: Final = 0.05  # [rad], after which how friction stood before hardly counts
NO_CONTACT: Final = "no contact, whose threshold takes free motion (--free RECORDING)"
_HOUR: Final = 3600.0  # [s]
_FEWEST: Final = 20  # peaks that a tail is fitted to
_PART: Final = 0.1  # of all peaks, that are tail


@dataclass(frozen=True, eq=False)
class ContactThresholds:
    """From where on external torque is a contact."""

    level: FloatArray  # (n,), in standard deviations of the error
    error: FloatArray  # (n,) [N m], the standard deviation where the model knows none; else NaN
    false_alarms: float  # of the whole arm [1/h]
    seconds: float  # of free motion, of the joint with the least that counts

    def __str__(self) -> str:
        """Return the rate of false alarms, and what it is known from."""
        alarms = f"{self.false_alarms:g} false alarm{'s' * (self.false_alarms != 1.0)} of contact"
        return f"{alarms} an hour, from {self.seconds:.0f} s of free motion"

    def values(self) -> dict[str, object]:
        """Return the fields as JSON values."""
        return {
            "threshold": self.level.tolist(),
            "error": [None if np.isnan(own) else own for own in self.error.tolist()],
            "false_alarms": self.false_alarms,
            "seconds": self.seconds,
        }

    def of_joint(self, j: int) -> str:
        """Return the threshold of a joint, numbered from 0."""
        level, error = self.level[j], self.error[j]
        known = "" if np.isnan(error) else f", {level * error:.3g} N m"
        return f"{level:.3g} standard deviations{known}"


def measured_contact(
    false_alarms: float,
    stream: Stream,
    simulation: Simulation,
    free: Sequence[Recording],
    *,
    in_torque: bool = False,
) -> ContactThresholds:
    """Return from where on external torque is a contact, by the errors on free motion.

    Args:
        false_alarms: Wanted of the whole arm [1/h].
        stream: Of the model.
        simulation: What the model adds to.
        free: Motion that nothing touched, and that the model was not trained on.
        in_torque: Whether thresholds are torques, whatever errors the model states, and hold where
            it says that the motion is unlike what was learned, too.

    Raises:
        ConfigError: The rate of alarms is not possible.
        RecordingError: A recording has another rate or no torque, or errors have too few peaks.
    """
    if not 0.0 < false_alarms < math.inf:
        raise ConfigError(f"{false_alarms:g} false alarms an hour, expected more than 0")
    for recording in free:
        recording.check_robot(simulation.model)
    parts = [_errors(stream, recording, everywhere=in_torque) for recording in free]
    error, std, counts = (np.concatenate(part) for part in zip(*parts, strict=True))
    if in_torque:
        std = np.full_like(std, np.nan)
    seconds = counts.sum(axis=0) / stream.rate
    names = simulation.model.joint_names
    for name, time in zip(names, seconds, strict=True):
        if not time:
            raise RecordingError(
                f"{name} has no error that counts in {len(counts) / stream.rate:.3g} s of free "
                "motion: the filter fills, or the motion is unlike what was learned; record longer "
                "motion like that of the training"
            )
    square = np.mean(error**2, axis=0, where=counts)
    rms = np.where(np.isnan(std[0]), np.sqrt(np.maximum(square, np.finfo(float).tiny)), np.nan)
    size = np.where(counts, np.abs(error) / np.where(np.isnan(rms), std, rms), 0.0)
    ends = np.cumsum([len(part) for part, _, _ in parts])[:-1]
    apart = math.ceil(stream.rate / stream.model.bandwidth)
    level = np.empty(stream.n)
    for j, name in enumerate(names):
        peaks = np.concatenate([_peaks(own, apart) for own in np.split(size[:, j], ends)])
        if peaks.size < _FEWEST:
            longer = seconds[j] * _FEWEST / max(peaks.size, 1)
            raise RecordingError(
                f"{name}: {peaks.size} peaks of the error in {seconds[j]:.3g} s of free motion, "
                f"expected {_FEWEST}; record some {longer:.0f} s, like that of the training"
            )
        level[j] = _level(peaks, seconds[j], false_alarms / _HOUR / stream.n)
    return ContactThresholds(level, rms, false_alarms, float(seconds.min()))


def _errors(
    stream: Stream, recording: Recording, *, everywhere: bool
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return errors on free motion, their standard deviation, and which count, (T, n) each."""
    recording.check_torque()
    stream.check_rate(recording)
    late, _ = stream.advance(stream.init(), recording.time, recording.position, recording.torque)
    usable = np.ones_like(late.outside) if everywhere else ~late.outside
    gaps = np.flatnonzero(np.abs(np.diff(recording.time)) > stream.longest_step) + 1
    for start in (0, *gaps):
        usable[start : start + 2 * stream.samples] = False  # the filter fills
    return np.asarray(late.measured) - late.torque, late.std, usable


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
