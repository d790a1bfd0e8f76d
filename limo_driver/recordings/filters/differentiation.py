"""Differentiate and smooth sampled joint signals without phase.

Each contiguous stretch is brought to an even grid, filtered forward and backward with a
Butterworth low-pass of order 4 (half the amplitude at the bandwidth), differentiated with central
differences of order 12, and read back at the recorded instants. Positions and torques that went
through the same filter stay comparable: none lags behind the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import factorial

import numpy as np

from limo_driver.errors import RecordingError
from limo_driver.runtime.compiled import compiled
from limo_driver.types import FloatArray, IntArray

ORDER = 4  # of the Butterworth filter; run twice, hence 8
HIGHEST_BANDWIDTH = 0.4  # of the sampling rate; nearer to 0.5 the filter has no room to fall
SAFE_BANDWIDTH = 0.9 * HIGHEST_BANDWIDTH  # the rate of an uneven recording is a mean
LEAST_PERIODS = 0.5  # [1/bandwidth] that a recording has to last
EDGE = 0.5  # [1/bandwidth] from an end of a stretch within which derivatives are less sure
_PADDING = 6.0  # [1/bandwidth]; the filter has forgotten 1 - 5e-7 of what was before
_FIT = 2.0  # [1/bandwidth], window of the quintic that continues an end
_EVEN = 1e-4  # [sample periods], deviation from an even grid that needs no interpolation
_CLOSE = 0.25  # [sample periods]; nearer neighbours would blow up their noise in a spline
_AT_ONCE = 1024  # values that a stencil passes over
_FEW = 24  # columns up to which calls, step by step, would cost more than what they do
_HALF = 6  # half width of the difference stencils


@dataclass(frozen=True)
class Derivatives:
    """A smoothed signal and its first two derivatives, each (T, k)."""

    value: FloatArray
    first: FloatArray
    second: FloatArray


def differentiate(
    time: FloatArray, values: FloatArray, bandwidth: float, segments: Sequence[slice]
) -> Derivatives:
    """Smooth `values` and differentiate them twice.

    Args:
        time: (T,) [s], strictly increasing.
        values: (T, k), any unit.
        bandwidth: Frequency at which the amplitude is halved [Hz].
        segments: Contiguous stretches that cover all rows; nothing passes between them.

    Raises:
        RecordingError: The bandwidth is too high for the sampling rate, or too low for its length.
    """
    _check_lowest(bandwidth, time)
    result = Derivatives(*(np.empty(values.shape) for _ in range(3)))
    for rows in segments:
        stretch = FilteredStretch(time[rows], bandwidth)
        padded = stretch.filter(values[rows])
        result.value[rows] = stretch.read(padded)
        result.first[rows] = stretch.read(_stencil(padded, _FIRST) / stretch.period)
        result.second[rows] = stretch.read(_stencil(padded, _SECOND) / stretch.period**2)
    return result


def smooth(
    time: FloatArray, values: FloatArray, bandwidth: float, segments: Sequence[slice]
) -> FloatArray:
    """Smooth `values` exactly as `differentiate` does; same arguments, (T, k)."""
    _check_lowest(bandwidth, time)
    result = np.empty(values.shape)
    for rows in segments:
        stretch = FilteredStretch(time[rows], bandwidth)
        result[rows] = stretch.read(stretch.filter(values[rows]))
    return result


def stretch_of(time: FloatArray, bandwidth: float) -> FilteredStretch:
    """Return the filter of one contiguous stretch (T,) [s], for whoever filters much of it.

    Raises:
        RecordingError: As `differentiate` does.
    """
    _check_lowest(bandwidth, time)
    return FilteredStretch(time, bandwidth)


def impulse_responses(bandwidth: float, rate: float, half: int) -> FloatArray:
    """Return what `differentiate` makes of an impulse: value and derivatives, (3, 2 half + 1).

    Args:
        bandwidth: Frequency at which the amplitude is halved [Hz].
        rate: Of the samples [Hz].
        half: Samples before and after the impulse.
    """
    reach = max(half, int(np.ceil(_PADDING / bandwidth * rate))) + _HALF
    value = np.zeros((2 * reach + 1, 1))
    value[reach] = 1.0
    _there_and_back(value, *_filter(bandwidth, 1.0 / rate))
    responses = value, _stencil(value, _FIRST) * rate, _stencil(value, _SECOND) * rate**2
    return np.array(responses)[:, reach - half : reach + half + 1, 0]


@lru_cache(maxsize=64)
def _filter(bandwidth: float, period: float) -> tuple[FloatArray, FloatArray]:
    """Design the low-pass: s second-order sections (s, 6) and their state (s, 2) after ones.

    Butterworth's by the bilinear transform, each section of gain 1 for a constant. `scipy.signal`
    has the same, and takes a second to import, which a service that comes back does not have.
    """
    angle = np.pi * (2 * np.arange(ORDER // 2) + ORDER + 1) / (2 * ORDER)
    analogue = np.tan(np.pi * bandwidth * period) * np.exp(1j * angle)  # one pole of each pair
    poles = (1 + analogue) / (1 - analogue)
    a1, a2 = -2 * poles.real, np.abs(poles) ** 2
    gain = (1 + a1 + a2) / 4
    sections = np.stack([gain, 2 * gain, gain, np.ones_like(gain), a1, a2], axis=1)
    return sections, np.stack([1 - gain, gain - a2], axis=1)


def _there_and_back(values: FloatArray, sos: FloatArray, steady: FloatArray) -> None:
    """Filter columns (T, k) forwards and backwards, in place, each way as if at rest before.

    As `scipy.signal.sosfiltfilt`, which goes through one column after the other; here
    all columns, which lie together in memory, take each step at once, which is faster by a factor
    of two to five.
    """
    sweep = _sweep_few if values.shape[1] <= _FEW else _sweep
    sweep(values, False, sos, steady[:, :, None] * values[0])
    sweep(values, True, sos, steady[:, :, None] * values[-1])


@compiled()
def _sweep(values: FloatArray, backwards: bool, sos: FloatArray, state: FloatArray) -> None:
    T = values.shape[0]
    for k in range(T):
        t = T - 1 - k if backwards else k  # reversed rows would be compiled anew, as another type
        for s in range(sos.shape[0]):
            _advance(values[t], state[s, 0], state[s, 1], sos[s])


@compiled()
def _advance(row: FloatArray, first: FloatArray, second: FloatArray, section: FloatArray) -> None:
    """Take one step of one section; on its own, so that the compiler makes one loop of vectors."""
    b0, b1, b2, a1, a2 = section[0], section[1], section[2], section[4], section[5]
    for k in range(row.size):
        x, one, two = row[k], first[k], second[k]
        y = b0 * x + one
        first[k] = b1 * x - a1 * y + two
        second[k] = b2 * x - a2 * y
        row[k] = y


@compiled()
def _sweep_few(values: FloatArray, backwards: bool, sos: FloatArray, state: FloatArray) -> None:
    """Do what `_sweep` does, bit for bit; of one column in a sixth of its time."""
    T = values.shape[0]
    for i in range(T):
        t = T - 1 - i if backwards else i
        for s in range(sos.shape[0]):
            b0, b1, b2, a1, a2 = sos[s, 0], sos[s, 1], sos[s, 2], sos[s, 4], sos[s, 5]
            for k in range(values.shape[1]):
                x, one, two = values[t, k], state[s, 0, k], state[s, 1, k]
                y = b0 * x + one
                state[s, 0, k] = b1 * x - a1 * y + two
                state[s, 1, k] = b2 * x - a2 * y
                values[t, k] = y


class FilteredStretch:
    """One contiguous stretch of samples, its even grid and its filter."""

    def __init__(self, time: FloatArray, bandwidth: float) -> None:
        self.time = time - time[0]
        count = round(self.time[-1] / float(np.median(np.diff(time)))) + 1
        self.grid = np.linspace(0.0, self.time[-1], count)
        self.period = float(self.grid[1])
        self.bandwidth = bandwidth
        self.even = count == time.size and bool(
            np.abs(self.grid - self.time).max() < _EVEN * self.period
        )
        _check_bandwidth(bandwidth, 1.0 / self.period)
        self.padding = int(np.ceil(_PADDING / bandwidth / self.period)) + _HALF

    def filter(self, *signals: FloatArray) -> FloatArray:
        """Filter signals (T, k) each, side by side.

        Returns:
            Their values on the grid, with `padding` rows before and after.
        """
        ends = np.cumsum([0, *(values.shape[1] for values in signals)])
        padded = np.empty((self.grid.size + 2 * self.padding, int(ends[-1])))
        even = padded[self.padding : self.padding + self.grid.size]
        for values, first, stop in zip(signals, ends, ends[1:], strict=False):
            even[:, first:stop] = values if self.even else self._to_grid(values)
        padded[: self.padding] = self._before(even)
        padded[self.padding + self.grid.size :] = self._before(even[::-1])[::-1]
        _there_and_back(padded, *_filter(self.bandwidth, self.period))
        return padded

    def read(self, padded: FloatArray, some: IntArray | None = None) -> FloatArray:
        """Return grid values at the recorded instants, or at some of them."""
        on_grid = padded[self.padding : padded.shape[0] - self.padding]
        if self.even:
            return on_grid if some is None else on_grid[some]
        return _spline(self.grid, on_grid, self.time if some is None else self.time[some])

    def _to_grid(self, values: FloatArray) -> FloatArray:
        keep = np.append(True, np.diff(self.time) > _CLOSE * self.period)
        return _spline(self.time[keep], values[keep], self.grid)

    def _before(self, values: FloatArray) -> FloatArray:
        """Continue `values` backwards in time, smoothly enough for two derivatives.

        Mirrored through the origin, x(-t) = -x(t), only odd powers of t continue smoothly; the
        usual odd extension makes the acceleration jump to its opposite. So the even powers of a
        quintic fitted to the end are taken out before mirroring and put back afterwards. The
        filter passes polynomials of that degree unchanged.
        """
        window = min(max(int(_FIT / self.bandwidth / self.period), 8), values.shape[0])
        powers, even_before = _powers(window, self.padding)
        quintic = np.linalg.lstsq(powers, values[:window], rcond=None)[0]
        steps = np.arange(self.padding, 0, -1)
        even = even_before @ quintic[::2]
        return 2 * even - values[np.minimum(steps, values.shape[0] - 1)]


@lru_cache(maxsize=64)
def _powers(window: int, steps: int) -> tuple[FloatArray, FloatArray]:
    """Return powers 0 to 5 of time over a window (window, 6), and even ones before it (steps, 3).

    Before it, the farthest of so many steps comes first.
    """
    before = np.vander((np.arange(steps, 0, -1) / window) ** 2, 3, increasing=True)
    return np.vander(np.arange(window) / window, 6, increasing=True), before


def _spline(time: FloatArray, values: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import CubicSpline

    return CubicSpline(time, values)(at)


def _check_bandwidth(bandwidth: float, rate: float) -> None:
    if not 0 < bandwidth <= HIGHEST_BANDWIDTH * rate:
        raise RecordingError(
            f"a bandwidth of {bandwidth:g} Hz does not suit a recording sampled at {rate:.4g} Hz; "
            f"give more than 0 and at most {_below(HIGHEST_BANDWIDTH * rate):g} Hz"
        )


def _below(value: float) -> float:
    """Round down to a thousandth of a value, so that what a message offers is allowed."""
    digits = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(np.floor(value / digits * (1 + 1e-12)) * digits)


def _check_lowest(bandwidth: float, time: FloatArray) -> None:
    """Refuse a bandwidth that would make the padding far longer than the recording."""
    if time.size < 2:  # noqa: PLR2004
        raise RecordingError(
            f"is too short to be filtered: samples {time.size}, expected 2 or more"
        )
    duration = float(time[-1] - time[0])
    if 0 < bandwidth < LEAST_PERIODS / duration:
        raise RecordingError(
            f"a bandwidth of {bandwidth:g} Hz is too low for a recording of {duration:.3g} s; "
            f"give at least {LEAST_PERIODS / duration:.3g} Hz"
        )


def _stencil(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Apply a stencil of 2 _HALF + 1 weights along time; `_HALF` rows at each end stay zero."""
    result = np.zeros_like(values)
    _add_stencil(values, weights, result)
    return result


@compiled()
def _add_stencil(values: FloatArray, weights: FloatArray, result: FloatArray) -> None:
    """Add what each weight makes of the rows (T, k) that it reaches, some at a time.

    As many as stay in the fastest memory while all weights pass over them.
    """
    half, width = weights.size // 2, values.shape[1]
    given, made = values.reshape(-1), result.reshape(-1)
    last = given.size - half * width
    for start in range(half * width, last, _AT_ONCE):
        some = made[start : min(start + _AT_ONCE, last)]
        for k in range(weights.size):
            if weights[k] != 0.0:
                reached = given[start + (k - half) * width :]
                for i in range(some.size):
                    some[i] += weights[k] * reached[i]


def _weights(derivative: int) -> FloatArray:
    """Return the central difference weights of order 2 _HALF for derivative 1 or 2.

    Source: Fornberg, "Generation of finite difference formulas", Math. Comp. 51, 1988.
    """
    k = np.arange(1, _HALF + 1)
    ratio = [factorial(_HALF) ** 2 / (factorial(_HALF - i) * factorial(_HALF + i)) for i in k]
    side = derivative * (-1.0) ** (k + 1) * np.array(ratio) / k**derivative
    mirrored = (-side if derivative == 1 else side)[::-1]
    return np.concatenate([mirrored, [0.0 if derivative == 1 else -2 * side.sum()], side])


_FIRST = _weights(1)
_SECOND = _weights(2)
