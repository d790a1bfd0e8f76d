"""The threshold of external torque that gives a stated rate of false alarms.

It counts in standard deviations of the model's error, and is found of recorded free motion: where
nothing touches the arm, external torque is error. Each time it rises above a level u and falls
again, its largest value is a peak; peaks further apart than 1/bandwidth are taken for independent.
With u so that K peaks lie above it, by b on average, in the time T, the tail of an exponential
distribution whose b is known from m stretches of motion with such peaks gives

    rate of alarms = (K / T) (1 + (k - u) / (m b))^-m

for each joint, of which it has the n-th part of what is bearable. Errors at creep are not those of
travel, so that each has a tail of its own, and the larger level holds: a motion may be all of one
kind. Where free motion showed no such speed, acceleration or torque, nobody knows how wrong the
model is, and what there is of external torque is not called a contact. A model that knows no
errors, as a simulation alone, is given the RMS of those on that motion. Without any, no code of
contact is written: errors peak at reversals, far beyond what normal ones of the same size do.

Source: Coles, "An Introduction to Statistical Modeling of Extreme Values", 2001, ch. 4 and 5
(peaks over thresholds, declustering); the predictive tail with a vague prior of b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.special import gammaincinv

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
SLOW: Final = 0.03  # [rad/s], below which a joint creeps
_BLOCK: Final = 5.0  # [s] of motion, in which errors are not independent
_BLOCKS: Final = 5  # that a tail is known from
_KINDS: Final = (f"below {SLOW:g} rad/s", f"above {SLOW:g} rad/s")


class _Tail(NamedTuple):
    """Peaks of a joint's error at slow or at fast motion."""

    above: float  # u, in standard deviations
    mean: float  # b, likewise
    often: float  # K / T [1/s]
    blocks: float  # m, at most K

    def level(self, wanted: float) -> float:
        """Return what is passed at a rate [1/s]."""
        grown = max(self.often / wanted, 1.0) ** (1.0 / self.blocks) - 1.0
        return self.above + self.blocks * self.mean * grown

    def rates(self, level: float) -> FloatArray:
        """Return the bounds of the rate [1/s] at a level, by what is known of b in 95 %."""
        bounds, beyond = gammaincinv(self.blocks, [0.975, 0.025]), max(level - self.above, 0.0)
        return self.often * np.exp(-bounds * beyond / (self.blocks * self.mean))


@dataclass(frozen=True, eq=False)
class ContactThresholds:
    """From where on external torque is a contact."""

    level: FloatArray  # (n,), in standard deviations of the error
    error: FloatArray  # (n,) [N m], the standard deviation where the model knows none; else NaN
    false_alarms: float  # of the whole arm [1/h]
    seconds: float  # of free motion, of the joint with the least that counts
    rates: FloatArray  # (2,) of the whole arm [1/h], 95 % interval
    speeds: NDArray[np.bool_]  # (n, 2), whether errors below and above `SLOW` are known
    covered: FloatArray  # (2, n, 3) least and most [rad/s, rad/s², N m] of free motion

    def __str__(self) -> str:
        """Return the rate of false alarms, and what it is known from."""
        alarms = f"{self.false_alarms:g} false alarm{'s' * (self.false_alarms != 1.0)} of contact"
        low, high = self.rates
        return (
            f"{alarms} an hour (95 %: {low:.1g} to {high:.1g}), from {self.seconds:.0f} s of free "
            "motion; not known at speeds, accelerations and torques that it did not show"
        )

    def values(self) -> dict[str, object]:
        """Return the fields as JSON values."""
        return {
            "threshold": self.level.tolist(),
            "error": [None if np.isnan(own) else own for own in self.error.tolist()],
            "false_alarms": self.false_alarms,
            "seconds": self.seconds,
            "rates": self.rates.tolist(),
        }

    def of_joint(self, j: int) -> str:
        """Return the threshold of a joint, numbered from 0."""
        level, error = self.level[j], self.error[j]
        torque = "" if np.isnan(error) else f", {level * error:.3g} N m"
        (slowest, _, _), (fastest, _, _) = self.covered[:, j]
        missing = [kind for kind, known in zip(_KINDS, self.speeds[j], strict=True) if not known]
        unknown = "".join(f"; not known {kind}" for kind in missing)
        shown = f"; shown from {slowest:.2g} to {fastest:.2g} rad/s{unknown}"
        return f"{level:.3g} standard deviations{torque}{shown}"


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
    parts = [_free(stream, recording, everywhere=in_torque) for recording in free]
    error, std, counts, motion = (np.concatenate(part) for part in zip(*parts, strict=True))
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
    slow = np.abs(motion[..., 0]) < SLOW
    ends = np.cumsum([len(part) for part, *_ in parts])[:-1]
    wanted = false_alarms / _HOUR / stream.n
    level, rates = np.empty(stream.n), np.zeros(2)
    speeds = np.zeros((stream.n, 2), dtype=np.bool_)
    for j, (name, own) in enumerate(zip(names, size.T, strict=True)):
        at = np.stack([slow[:, j], ~slow[:, j], np.ones_like(slow[:, j])])
        parts_of = [np.split(part, ends) for part in at * own]
        peaks = [_sorted_peaks(part, stream) for part in parts_of]
        speeds[j] = [found.size > _FEWEST for found in peaks[:2]]
        alone = [found.size > 4 * _FEWEST for found in peaks[:2]]
        together = not all(alone) and peaks[2].size > _FEWEST  # what is in passing, with all
        judged = (*alone, together)
        tails = [_tail(peaks[k], parts_of[k], stream) for k in range(3) if judged[k]]
        known = [(tail.level(wanted), tail) for tail in tails if tail is not None]
        if not known:
            longer = max(2.0 * seconds[j], 4.0 * _BLOCKS * _BLOCK)
            raise RecordingError(
                f"{name}: few peaks of the error in {seconds[j]:.3g} s of free motion, expected "
                f"more than {_FEWEST} at creep or at travel, the largest in {_BLOCKS} stretches of "
                f"{_BLOCK:g} s; record some {longer:.0f} s, like that of the training"
            )
        level[j], worst = max(known, key=lambda pair: pair[0])
        rates += _HOUR * worst.rates(level[j])
    covered = np.stack([part(motion[counts.any(axis=1)], axis=0) for part in (np.min, np.max)])
    return ContactThresholds(level, rms, false_alarms, seconds.min(), rates, speeds, covered)


def _free(
    stream: Stream, recording: Recording, *, everywhere: bool
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], FloatArray]:
    """Return errors, their standard deviation, which count, and the motion, (T, n) and (T, n, 3).

    The last are velocity, acceleration and torque of the simulation.
    """
    recording.check_torque()
    stream.check_rate(recording)
    late, _ = stream.advance(stream.init(), recording.time, recording.position, recording.torque)
    filtering = stream.differentiator
    values, _ = filtering.filter(filtering.init(stream.n), recording.time, recording.position)
    usable = np.ones_like(late.outside) if everywhere else ~late.outside
    gaps = np.flatnonzero(np.abs(np.diff(recording.time)) > stream.longest_step) + 1
    for start in (0, *gaps):
        usable[start : start + 2 * stream.samples] = False  # the filter fills
    motion = np.stack([values[1], values[2], late.simulation], axis=-1)
    return np.asarray(late.measured) - late.torque, late.std, usable, motion


def _sorted_peaks(sizes: Sequence[FloatArray], stream: Stream) -> FloatArray:
    """Return the peaks of errors, in standard deviations, the largest first."""
    apart = math.ceil(stream.rate / stream.model.bandwidth)
    return np.sort(np.concatenate([_peaks(size, apart) for size in sizes]))[::-1]


def _tail(peaks: FloatArray, sizes: Sequence[FloatArray], stream: Stream) -> _Tail | None:
    """Return the tail of peaks; None where too few came, or all of them at once."""
    count = max(_FEWEST - 1, math.ceil(_PART * peaks.size))
    above = float(peaks[count])
    rows = math.ceil(_BLOCK * stream.rate)
    largest = [own[k : k + rows].max() for own in sizes for k in range(0, own.size, rows)]
    hit = np.array([own > above for own in largest if own > 0.0])
    # of as many blocks that hold none, as independent ones would leave
    blocks = min(-hit.size * math.log1p(-min(hit.mean(), 1.0 - 1e-9)), float(count))
    if blocks < _BLOCKS:
        return None
    time = sum(np.count_nonzero(size) for size in sizes) / stream.rate
    return _Tail(above, float(np.mean(peaks[:count] - above)), count / time, blocks)


def _peaks(size: FloatArray, apart: int) -> FloatArray:
    """Return the largest value of each stretch of `apart` samples that is above its neighbours."""
    blocks = np.append(size, np.zeros(-size.size % apart)).reshape(-1, apart).max(axis=1)
    above: NDArray[np.bool_] = blocks > 0.0
    before, after = np.append(0.0, blocks[:-1]), np.append(blocks[1:], 0.0)
    return blocks[above & (blocks >= before) & (blocks > after)]
