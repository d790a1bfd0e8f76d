"""Chatter: torque that swings to and fro at one frequency, above all that motion asks of it.

A controller that hunts, friction compensation that changes its sign at rest, or a gear that rings
make it. Filters take it away, and friction looks smaller than it is, as it does under dither.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from limo_driver.recordings.recording import Recording

_ABOVE: Final = 1.5  # times the bandwidth of motion, from which an oscillation is chatter
_FEWEST_RATES: Final = 4.0  # sampling rate over bandwidth; less shows nothing above
_PIECE: Final = 512  # samples of each spectrum
_FEWEST_PIECES: Final = 3
_AT_ONE: Final = 0.5  # of the power above, within `_WIDTH` of one frequency; noise has it nowhere
_WIDTH: Final = 0.1  # relative
_NARROW: Final = 3.0  # times the share that even noise would have there
_STANDS_OUT: Final = 4.0  # times the power just above motion
_MATTERS: Final = 0.03  # of a torque's standard deviation, and
_STEPS: Final = 2.0  # steps in which the torque comes, below which it is no news


@dataclass(frozen=True)
class Chatter:
    """An oscillation of one joint's torque."""

    joint: int  # 1-based
    frequency: float  # [Hz]
    rms: float  # [N m]

    def __str__(self) -> str:
        """Say it in a few words."""
        return f"joint {self.joint} by {self.rms:.2g} N m RMS at {self.frequency:.3g} Hz"


def chatter_of(
    recording: Recording, bandwidth: float, steps: tuple[float, ...]
) -> tuple[Chatter, ...]:
    """Return which torques oscillate, and how.

    Args:
        recording: T samples of n joints.
        bandwidth: Of motion [Hz].
        steps: In which each joint's torque comes, (n,) [N m]; 0 where it has none.
    """
    from scipy.signal import welch

    longest = max(recording.segments, key=lambda rows: rows.stop - rows.start)
    rate = recording[longest].rate if longest.stop - longest.start > 1 else 0.0
    many = longest.stop - longest.start
    if rate < _FEWEST_RATES * bandwidth or many < _FEWEST_PIECES * _PIECE:
        return ()
    found = list[Chatter]()
    for j, torque in enumerate(recording.torque[longest].T):
        frequency, density = welch(torque, rate, nperseg=_PIECE, detrend="linear")
        above = frequency > _ABOVE * bandwidth
        power = density[above] * (frequency[1] - frequency[0])
        total = float(power.sum())
        if not total:
            continue
        peak = float(frequency[above][power.argmax()])
        near = np.abs(frequency[above] - peak) <= max(_WIDTH * peak, 2 * frequency[1])
        share, even = float(power[near].sum()) / total, float(near.mean())
        rms = float(np.sqrt(power[near].sum()))
        least = max(_MATTERS * float(np.std(torque)), _STEPS * steps[j])
        stands_out = float(power.max()) > _STANDS_OUT * float(power[0])  # is no slope's foot
        if stands_out and share > max(_AT_ONE, min(_NARROW * even, 1.0)) and rms > least:
            found.append(Chatter(j + 1, peak, rms))
    return tuple(found)
