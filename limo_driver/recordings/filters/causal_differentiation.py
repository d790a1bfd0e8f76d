"""Differentiate and smooth live joint positions, a stated delay behind.

What `differentiation` does to a whole recording, a filter with a finite symmetric response does to
a stream: its taps are the response of that zero-phase filter and of its first two derivatives,
tapered (Tukey) to the samples that are there, from `delay` before to `delay` after the instant that
is answered. So it has no phase but the delay, and a model sees live what it was trained on. The
taper is corrected so that polynomials up to degree 5, or 7 for long delays, are differentiated
exactly, as the zero-phase filter does: motion that is slow against the delay loses nothing.

A shorter delay hears more of the encoder's noise. RMS against the zero-phase filter at 10 Hz, small
motion of up to 1 Hz at 1 kHz, encoder steps of 1e-5 rad (printed by
`benchmarks/estimators/step.py`):

    delay      velocity [rad/s]   acceleration [rad/s^2]
     20 ms     1.8e-4             3.1e-2
     50 ms     4.4e-5             3.1e-3
    100 ms     1.7e-5             8.6e-4
    200 ms     5.0e-7             3.2e-5
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial
from typing import Final

import numpy as np

from limo_driver.errors import ConfigError, RecordingError, ShapeError
from limo_driver.recordings.filters.differentiation import HIGHEST_BANDWIDTH, impulse_responses
from limo_driver.recordings.gate.held_values import LONGEST_STEP, LONGEST_STEP_PERIODS
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, JointSample, Motion

FEWEST_SAMPLES: Final = 3  # of delay; fewer cannot be exact to degree 5
LONGEST_DELAY: Final = 5.0  # [s]; far beyond what the filter remembers at any usual bandwidth
MOST_SAMPLES: Final = 25_000  # of delay, as many as that is at 5 kHz
RATE_TOLERANCE: Final = 0.01  # of the stated rate, by which velocities would be wrong
LARGEST: Final = 1e9  # of a value; squares of derivatives of much larger ones overflow
LONGEST_GAP: Final = 0.2  # [s] that memory outlives; friction seldom turns over unseen in less
_LONG: Final = 0.75  # [1/bandwidth] of delay, from which degree 7 costs less noise than it gains
_TAPER: Final = 0.5  # of each half that falls to zero; more would soften the filter itself


@dataclass(frozen=True)
class DelayLine:
    """The latest positions, which are all the memory there is."""

    time: float  # [s] of the last; NaN before the first
    positions: FloatArray  # (n, 2 delay + 1) [rad], the last one at the end


class CausalFilter:
    """Taps that pass over n signals as they come, `delay` behind them.

    Samples are expected evenly, at `rate`: jitter is not corrected. Lost samples are bridged
    linearly, up to `longest_gap`: what comes out is as good as without a gap up to
    `longest_step`, that the data gate takes for none, and else once the taps have passed it. Before
    the first sample, the signals are taken to have been what they are then.

    Args:
        rate: Of the samples [Hz].
        taps: Of K filters, (K, 2 delay + 1), oldest sample first.
    """

    def __init__(self, rate: float, taps: FloatArray) -> None:
        self.rate, self.taps = rate, taps
        self.samples = taps.shape[1] // 2  # by which it is late
        self.longest_step = max(LONGEST_STEP, LONGEST_STEP_PERIODS / rate)  # [s]; longer is a gap
        self.longest_gap = max(LONGEST_GAP, self.longest_step)  # [s]

    @classmethod
    def smoother(cls, rate: float, bandwidth: float, samples: int) -> CausalFilter:
        """Return the one filter that smooths as a `CausalDifferentiator` smooths positions."""
        return cls(rate, _taps(rate, bandwidth, samples)[:1])

    @property
    def delay(self) -> float:
        """Time by which what comes out is late [s]."""
        return self.samples / self.rate

    def init(self, n: int) -> DelayLine:
        """Return the memory of n signals before their first samples."""
        return DelayLine(np.nan, np.zeros((n, self.taps.shape[1])))

    def gap(self, memory: DelayLine, time: float) -> bool:
        """Say whether `time` [s] is so far from the last that memory has to start anew.

        Also backwards: a clock was set back, or the last time was wrong, and no later one could
        follow it any more. What is a little late is refused by `filter`.
        """
        return abs(time - memory.time) > self.longest_gap  # not before the first: its time is NaN

    def filter(
        self, memory: DelayLine, time: FloatArray, signals: FloatArray
    ) -> tuple[FloatArray, DelayLine]:
        """Take T samples without a gap.

        Args:
            memory: Memory after the sample before; not changed.
            time: (T,) [s], strictly increasing.
            signals: (T, n), in any unit.

        Returns:
            What the K filters make of them at `time - delay`, (K, T, n), and the memory after the
            last sample.

        Raises:
            ShapeError: The signals are not (T, n).
            RecordingError: The time does not increase, or a value is not finite.
        """
        values, line = self._passed(memory, time, signals)
        return values, DelayLine(float(time[-1]), line)

    def _passed(
        self, memory: DelayLine, time: FloatArray, signals: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return what the filters make of samples, and the latest of these, (n, 2 delay + 1)."""
        line = memory.positions.copy()
        if signals.shape != (time.size, line.shape[0]):
            raise ShapeError("position", signals.shape, f"({time.size}, {line.shape[0]})")
        values = np.empty((self.taps.shape[0], *signals.shape))
        bad = _scan(line, memory.time, self.rate, time, signals, self.taps, values)
        if bad >= 0:
            raise RecordingError(
                f"the sample at {time[bad]:.6g} s cannot follow the one before: its time has to "
                f"increase, and time and values have to be finite, no value beyond {LARGEST:g}",
                rows=[bad],
            )
        return values, line


class CausalDifferentiator(CausalFilter):
    """Motion of n joints, `delay` behind their positions.

    Before the first position, the arm is taken to have rested there: until two delays have passed,
    a start in motion looks abrupt.

    Args:
        rate: Of the positions [Hz].
        bandwidth: Frequency at which the zero-phase filter halves the amplitude [Hz].
        delay: Wanted delay [s]; the nearest number of samples is taken.

    Raises:
        ConfigError: A value is no positive number, the bandwidth is too high for the rate, or the
            delay is shorter than `FEWEST_SAMPLES`, or longer than `LONGEST_DELAY` or
            `MOST_SAMPLES`.
    """

    def __init__(self, rate: float, bandwidth: float, delay: float) -> None:
        # The delay in samples, of values that were found to be possible
        for name, value, unit in (
            ("rate", rate, "Hz"),
            ("bandwidth", bandwidth, "Hz"),
            ("delay", delay, "s"),
        ):
            if not 0 < value < np.inf:
                raise ConfigError(f"{name} = {value:g} {unit} has to be above 0 and finite")
        if bandwidth > HIGHEST_BANDWIDTH * rate:
            raise ConfigError(
                f"a bandwidth of {bandwidth:g} Hz is too high for positions at {rate:g} Hz; "
                f"at most {HIGHEST_BANDWIDTH * rate:.3g} Hz"
            )
        longest = min(LONGEST_DELAY, MOST_SAMPLES / rate)
        if delay > longest:
            raise ConfigError(
                f"a delay of {delay:g} s is too long at {rate:g} Hz; at most {longest:.3g} s"
            )
        samples = round(delay * rate)
        if samples < FEWEST_SAMPLES:
            raise ConfigError(
                f"a delay of {delay:g} s is {samples} samples at {rate:g} Hz; "
                f"at least {FEWEST_SAMPLES / rate:.3g} s, {FEWEST_SAMPLES} samples, are needed"
            )
        super().__init__(rate, _taps(rate, bandwidth, samples))
        self.bandwidth = bandwidth

    def step(
        self, memory: DelayLine, time: float, position: FloatArray
    ) -> tuple[JointSample, DelayLine]:
        """Take the next position and return the motion at `time - delay`.

        Args:
            memory: Memory after the position before; not changed.
            time: Of the position [s].
            position: (n,) [rad].

        Returns:
            The sample at `time - delay`, and the memory after this position.

        Raises:
            ShapeError: The position has another number of joints.
            RecordingError: The time does not increase, or a value is not finite.
        """
        motion, after = self.advance(memory, np.array([time]), np.asarray(position)[None])
        return motion.sample(0), after

    def advance(
        self, memory: DelayLine, time: FloatArray, position: FloatArray
    ) -> tuple[Motion, DelayLine]:
        """Take T positions without a gap: `step` for all of them in one.

        Args:
            memory: Memory after the position before; not changed.
            time: (T,) [s], strictly increasing.
            position: (T, n) [rad].

        Returns:
            The motion at `time - delay`, and the memory after the last position.

        Raises:
            ShapeError: The positions are not (T, n).
            RecordingError: The time does not increase, or a value is not finite.
        """
        values, after = self.filter(memory, time, position)
        return Motion.trusted(time - self.delay, values[0], values[1], values[2]), after


def _taps(rate: float, bandwidth: float, samples: int) -> FloatArray:
    """Return the taps of position, velocity and acceleration, (3, 2 samples + 1), oldest first.

    Taper w and response h give w (h + Σ a_i t^i), whose coefficients a make the moments right:
    Σ taps t^p is 0 but for p equal to the derivative, where it is p!.
    """
    steps = np.arange(-samples, samples + 1)
    t = steps / samples  # in units of the delay, so that the moments are of one size
    edge = (np.abs(steps) / (samples + 1) - (1 - _TAPER)) / _TAPER  # 0 to 1 within the taper
    window = 0.5 * (1 + np.cos(np.pi * np.clip(edge, 0, 1)))
    degree = 7 if samples > max(FEWEST_SAMPLES, _LONG * rate / bandwidth) else 5
    taps: list[FloatArray] = []
    for order, response in enumerate(impulse_responses(bandwidth, rate, samples)):
        powers = [p for p in range(degree + 1) if p % 2 == order % 2]  # the others vanish
        monomials = np.array([t**p for p in powers])
        moments = np.array([float(factorial(p)) if p == order else 0.0 for p in powers])
        moments *= (rate / samples) ** order
        tapered = window * response[::-1]  # a convolution takes the oldest by the last
        missing = moments - monomials @ tapered
        weights = np.linalg.solve(window * monomials @ monomials.T, missing)
        taps.append(tapered + window * (weights @ monomials))
    return np.array(taps)


@compiled(reads=("time", "position", "taps"), nogil=True, fastmath={"reassoc", "contract"})
def _scan(
    line: FloatArray,
    last: float,
    rate: float,
    time: FloatArray,
    position: FloatArray,
    taps: FloatArray,
    values: FloatArray,
) -> int:
    """Advance `line` (n, L) in place over T positions and fill values (K, T, n) by taps (K, L).

    Returns the first row that cannot follow the one before, or -1.
    """
    n, L = line.shape
    for t in range(time.size):
        lost = 0
        if np.isnan(last):
            for j in range(n):
                line[j] = position[t, j]
        elif time[t] > last:
            lost = max(int(np.round((time[t] - last) * rate)), 1) - 1
        else:
            return t
        last = time[t]
        if not np.isfinite(last):
            return t
        for j in range(n):
            own, q = line[j], position[t, j]
            if not abs(q) <= LARGEST:
                return t
            shift = min(lost + 1, L)
            rise = (q - own[L - 1]) / (lost + 1)
            for i in range(L - shift):  # own[...] = own[...] would compile the message of its error
                own[i] = own[i + shift]
            for i in range(shift):
                own[L - 1 - i] = q - i * rise
            for k in range(taps.shape[0]):
                value = 0.0
                for i in range(L):
                    value += taps[k, i] * own[i]
                values[k, t, j] = value
    return -1
