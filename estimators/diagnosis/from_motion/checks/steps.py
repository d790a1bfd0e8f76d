"""Which unit positions are in, by the steps in which encoders tell them.

An encoder on a joint divides a turn into a power of two: 2π / 4096 rad at 12 bit. Normalised
positions have steps of their own, as each joint's range is another number of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

_CHANGES: Final = 50  # of a joint's position, fewer of which show no step
_WHOLE: Final = 0.02  # of a step, by which changes are whole numbers of it
_SHARE: Final = 0.98  # of the changes, that have to be
_LIKE: Final = 0.01  # of a step, by which two are alike
_FINEST: Final = 1e-6  # [rad], a step of no encoder: finer ones are of numbers of 32 bits


def odd_steps(recording: Recording) -> str:
    """Say which joints' positions come in steps of no encoder's, or nothing.

    Args:
        recording: Of n joints.
    """
    steps = [_step(recording.position[:, j]) for j in range(recording.n)]
    odd = [j for j, step in enumerate(steps) if step > 0.0]
    if any(_of_a_turn(steps[j]) for j in odd):
        return ""
    different = [j for j in odd if abs(steps[j] / steps[odd[0]] - 1.0) > _LIKE]
    if not different:
        return ""
    j, k = odd[0], different[0]
    return (
        f"position_{j + 1} comes in steps of {steps[j]:.3g}, position_{k + 1} of {steps[k]:.3g}; "
        "steps of an encoder on a joint are a turn over a power of two, 0.00153 rad at 12 bit; "
        "are positions and commands normalised, as -1 to 1?"
    )


def _step(position: FloatArray) -> float:
    """Return the step of which all changes of a position are multiples; 0 if there is none.

    By the changes, since `telemetry.resolution`, which goes by the values, needs each some times.
    """
    changes = np.abs(np.diff(position))
    changes = changes[changes > 0.0]
    if changes.size < _CHANGES:
        return 0.0
    step = float(np.percentile(changes, 1, method="lower"))
    near = changes[changes < 1.5 * step]
    step = float(np.median(near))
    times = changes / step
    off = np.abs(times - np.round(times)) / np.maximum(np.round(times), 1.0)
    return step if step > _FINEST and float((off < _WHOLE).mean()) > _SHARE else 0.0


def _of_a_turn(step: float) -> bool:
    """Say whether a step [rad] is a turn over a power of two."""
    bits = np.log2(2.0 * np.pi / step)
    return bool(abs(bits - round(bits)) < np.log2(1.0 + _LIKE))
