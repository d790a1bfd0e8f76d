"""Sums over rows of many lines at once, compiled: a scan is of thousands of lines over each row.

As arrays of all of them, most of its time would go into moving what the filter passes of each to
memory and back.
"""

# pyright: reportIndexIssue=false
from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.recordings.filters.differentiation import ORDER
from limo_driver.runtime.compiled import compiled

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


@compiled(nogil=True, error_model="numpy")
def line_sums(
    position: FloatArray,
    speed: FloatArray,
    residual: FloatArray,
    first: float,
    step: float,
    count: int,
    bandwidth: float,
    least: float,
    block: int,
) -> FloatArray:
    """Sum up evenly spaced lines, each as the filter leaves it on R rows.

    A phase is a product, so that few exponentials are needed; and the filter leaves less of each
    line than of the one before, so that no row counts beyond the first one that it stops.

    Args:
        position: (R,) [rad].
        speed: Its size, (R,) [rad/s].
        residual: (R,) [N m].
        first: Line [1/rev].
        step: From each to the next [1/rev].
        count: Of lines.
        bandwidth: Of the filter [Hz].
        least: Gain of the filter below which a row does not count.
        block: Lines that share one exponential.

    Returns:
        Of each line residual times cosine and sine [N m], energy of the residual that is passed
        [N² m²], and rows that count; (4, count).
    """
    sums = np.zeros((4, count))
    cycles = first + step * np.arange(count)
    cosine, sine = np.ones(block), np.zeros(block)  # of each line over the first of its block
    for r in range(position.size):
        own = speed[r] / (2 * np.pi * bandwidth)
        energy = residual[r] * residual[r]
        cos, sin = math.cos(step * position[r]), math.sin(step * position[r])
        for k in range(1, block):
            cosine[k] = cos * cosine[k - 1] - sin * sine[k - 1]
            sine[k] = cos * sine[k - 1] + sin * cosine[k - 1]
        for start in range(0, count, block):
            if _passed(own * cycles[start]) < least:
                break
            phase = cycles[start] * position[r]
            ahead, aside = residual[r] * math.cos(phase), residual[r] * math.sin(phase)
            lines = slice(start, min(start + block, count))
            each, real, imaginary = cycles[lines], sums[0, lines], sums[1, lines]
            noise, rows = sums[2, lines], sums[3, lines]
            for k in range(real.size):
                gain = _passed(own * each[k])
                counts = 1.0 if gain >= least else 0.0
                gain *= counts
                real[k] += gain * (ahead * cosine[k] - aside * sine[k])
                imaginary[k] += gain * (ahead * sine[k] + aside * cosine[k])
                noise[k] += gain * gain * energy
                rows[k] += counts
    return sums


@compiled(nogil=True, error_model="numpy", inline="always")
def _passed(ratio: float) -> float:
    """Return what the filter passes of a frequency, over its bandwidth."""
    square = ratio * ratio
    power = 1.0
    for _ in range(ORDER):
        power *= square
    return 1.0 / (1.0 + power)
