"""Spectra of sampled signals, each the average of those of many short pieces.

A line is taken out of each piece, as what drifts would leak into all frequencies. All pieces are
computed at once: `scipy.signal.welch` does so one by one, thirty times slower on short pieces, and
its package takes as long to import as the rest of a command.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

HANN: Final = (0.5, -0.5)
BLACKMAN_HARRIS: Final = (0.35875, -0.48829, 0.14128, -0.01168)


def mean_density(values: FloatArray, rate: float, piece: int) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (F,) [Hz] and the one-sided power density of signals, (F, n) [unit²/Hz].

    Args:
        values: At least one piece of T samples of n signals, (T, n).
        rate: Of the samples [Hz].
        piece: Samples of a piece, an even number; each begins in the middle of the one before.

    Source: Welch, "The use of fast Fourier transform for the estimation of power spectra", IEEE
    TAU 1967.
    """
    each = [_densities(signal, rate, piece, HANN).mean(axis=0) for signal in values.T]
    return _frequencies(rate, piece), np.stack(each, axis=1)


def median_density(values: FloatArray, rate: float, piece: int) -> tuple[FloatArray, FloatArray]:
    """Return the same as `mean_density`, but what most pieces have: few with a step change nothing.

    Side lobes of its window are 92 dB down, so that low frequencies do not show in high ones.
    """
    found = [_densities(signal, rate, piece, BLACKMAN_HARRIS) for signal in values.T]
    each = [np.median(density, axis=0) / _median_of_mean(len(density)) for density in found]
    return _frequencies(rate, piece), np.stack(each, axis=1)


def _frequencies(rate: float, piece: int) -> FloatArray:
    return rate / piece * np.arange(piece // 2 + 1, dtype=np.float64)


def _densities(
    signal: FloatArray, rate: float, piece: int, window: tuple[float, ...]
) -> FloatArray:
    """Return the power density of each of P pieces of a signal (T,), (P, F)."""
    turn = 2 * np.pi * np.arange(piece) / piece
    weight = sum(a * np.cos(k * turn) for k, a in enumerate(window))
    line = np.linspace(-1.0, 1.0, piece)
    pieces = np.lib.stride_tricks.sliding_window_view(signal, piece)[:: piece // 2]
    level = pieces - pieces.mean(axis=1, keepdims=True)
    level -= np.outer(level @ (line / (line @ line)), line)
    amplitude = np.fft.rfft(level * weight, axis=1)
    power = np.square(amplitude.real) + np.square(amplitude.imag)
    power[:, 1:-1] *= 2.0  # of negative frequencies
    return power / (rate * np.sum(weight**2))


def _median_of_mean(pieces: int) -> float:
    """Return the median of so many densities of white noise, which are exponential, over the mean.

    Source: Allen et al., "FINDCHIRP", Physical Review D 2012, appendix B.
    """
    even = 2.0 * np.arange(1, (pieces - 1) // 2 + 1)
    return float(1.0 + np.sum(1.0 / (even + 1.0) - 1.0 / even))
