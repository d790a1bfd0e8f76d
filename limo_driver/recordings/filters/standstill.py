"""Differentiate live positions, and tell which joints stand still.

Dry friction follows the sign of the velocity, so that at rest the encoder's noise becomes torque,
however well it is filtered. Whether a joint rests is decided by its position: it does as long as
that stays where it came to rest, but for noise. So each joint has an anchor, the mean of its
positions since it last moved, or in the last `ANCHORED`. While the mean of the newest positions is
within `REACH` standard deviations of the anchor, and has been for `SETTLED`, the joint has no
velocity and no acceleration. One that leaves its anchor is let go at once: the newest positions are
`delay` ahead of the motion that is answered, so that a start is seen before it comes.

The noise of the encoder is what the filter takes from the positions, averaged over `NOISE_MEMORY`.
Where they do not change at all, as between two steps of a coarse encoder, nothing is heard of it,
and it is taken to be what it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from limo_driver.recordings.filters.causal_differentiation import CausalDifferentiator, DelayLine
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray

REACH: Final = 5.0  # standard deviations of the mean position, within which a joint rests
SETTLED: Final = 0.1  # [s] for which it has to; a reversal of 0.01 rad/s² is over by then
ANCHORED: Final = 0.25  # [s] that an anchor is the mean of; with more, creeping lets go again
NOISE_MEMORY: Final = 5.0  # [s], over which noise is averaged
NOTHING: Final = 1e-9  # [rad]; less noise than any encoder's
FAR: Final = 5.0  # standard deviations, beyond which a position is hit by something
MEMORY: Final = 5  # doubles a joint: see `_rest`


@dataclass(frozen=True)
class RestingLine(DelayLine):
    """The latest positions, and what each joint is anchored to."""

    anchors: FloatArray  # (n, MEMORY)


class RestingDifferentiator(CausalDifferentiator):
    """Motion of n joints, `delay` behind their positions; those that stand still have none.

    Args:
        rate: Of the positions [Hz].
        bandwidth: Frequency at which the zero-phase filter halves the amplitude [Hz].
        delay: Wanted delay [s]; the nearest number of samples is taken.

    Raises:
        ConfigError: As for a `CausalDifferentiator`.
    """

    def __init__(self, rate: float, bandwidth: float, delay: float) -> None:
        super().__init__(rate, bandwidth, delay)
        taps, self.latest = self.taps, self.samples
        newest, rough = np.zeros(taps.shape[1]), -taps[0]
        newest[-self.latest :] = 1.0 / self.latest  # their mean
        rough[self.samples] += 1.0  # what the filter takes from a position
        self.taps = np.array([*taps, newest, rough])
        self.to_noise = 1.0 / float(np.linalg.norm(rough))  # that is white
        self.anchored = max(round(ANCHORED * rate), self.latest)  # samples
        self.settled = max(round(SETTLED * rate), 1)  # samples
        self.remembered = max(round(NOISE_MEMORY * rate), 1)  # samples

    def init(self, n: int) -> RestingLine:
        """Return the memory of n joints before their first positions."""
        anchors = np.zeros((n, MEMORY))
        anchors[:, 4] = -self.taps.shape[1]  # nobody knows how positions before the first one were
        return RestingLine(**vars(super().init(n)), anchors=anchors)

    def filter(
        self, memory: DelayLine, time: FloatArray, signals: FloatArray
    ) -> tuple[FloatArray, RestingLine]:
        """Take T positions without a gap, see `CausalFilter`; motion comes first."""
        assert isinstance(memory, RestingLine)  # noqa: S101  # of this filter's own `init`
        values, line = self._passed(memory, time, signals)
        anchors = memory.anchors.copy()
        _rest(
            anchors,
            values,
            self.latest,
            self.to_noise,
            self.settled,
            self.anchored,
            self.remembered,
        )
        return values, RestingLine(float(time[-1]), line, anchors)


@compiled(nogil=True)
def _rest(
    anchors: FloatArray,
    values: FloatArray,
    latest: int,
    to_noise: float,
    settled: int,
    anchored: int,
    remembered: int,
) -> None:
    """Take velocity and acceleration from joints that stand still, in place.

    Args:
        anchors: Of each joint (n, MEMORY): position [rad], how many it is the mean of, for how many
            samples it has held, mean square of what the filter took [rad²], of how many samples,
            less than 0 while the filter fills.
        values: Position, velocity, acceleration, mean of the newest positions, and what the filter
            took, (5, T, n).
        latest: Samples of that mean.
        to_noise: From what the filter takes to the noise before it.
        settled: Samples for which an anchor has to hold.
        anchored: Samples that it is the mean of, at most.
        remembered: Samples over which noise is averaged.
    """
    for j in range(values.shape[2]):
        own = anchors[j]
        for t in range(values.shape[1]):
            square = values[4, t, j] ** 2
            if own[4] < 0.0:  # made up
                own[4] += 1.0
            elif square > NOTHING**2 or abs(values[3, t, j] - values[0, t, j]) > NOTHING:
                if own[4] == 0.0:
                    own[3] = square
                own[4] = min(own[4] + 1.0, remembered)
                own[3] += (min(square, FAR**2 * own[3] + NOTHING**2) - own[3]) / own[4]
            away = values[3, t, j] - own[0]
            held = max(own[1], 1.0)
            band = NOTHING + REACH * to_noise * math.sqrt(own[3] * (1.0 / latest + 1.0 / held))
            if own[1] > 0.0 and abs(away) <= band:
                own[1] = min(own[1] + 1.0, anchored)
                own[2] += 1.0
                own[0] += away / own[1]
            else:
                own[0] = values[3, t, j]
                own[1] = latest
                own[2] = 0.0
            if own[2] >= settled:
                values[1, t, j] = 0.0
                values[2, t, j] = 0.0
