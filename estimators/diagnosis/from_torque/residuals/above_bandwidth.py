"""What errors have above the bandwidth, of which a diagnosis says nothing.

Vibration, a hum of the mains or a ripple of a fast motor are filtered away before anything is
compared. Where they are most of what a simulation leaves of the torque, that is said.

Source: Welch, "The use of fast Fourier transform for the estimation of power spectra", 1967.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import welch

from estimators.diagnosis.settings.residuals import ABOVE
from limo_driver.recordings.bandwidth import bandwidth_at

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class _Band:
    """Frequencies above the bandwidth that stand out of a joint's noise."""

    joint: int  # 1-based
    share: float  # of the squared errors at all frequencies
    low: float  # [Hz]
    high: float  # [Hz]
    rate: float  # of the recording [Hz]


def above_note(simulation: Simulation, recordings: Sequence[Recording], bandwidth: float) -> str:
    """Say where most of what a simulation leaves lies above the bandwidth; nothing if it does not.

    Args:
        simulation: The improved one.
        recordings: With torques.
        bandwidth: Up to which they were compared [Hz].
    """
    found = [band for each in recordings for band in _bands(simulation, each, bandwidth)]
    most = max(found, key=lambda band: band.share, default=None)
    if most is None or most.share < ABOVE.share:
        return ""
    wanted = bandwidth
    while wanted < most.high:
        wanted *= 2.0
    wanted = bandwidth_at(most.rate, wanted)
    shown = (
        f"`--bandwidth {wanted:g}` looks at it, too"
        if wanted > most.high
        else f"with {most.rate:.3g} samples a second, no bandwidth shows it"
    )
    return (
        f"Of what the improved simulation leaves of the torque of joint {most.joint}, "
        f"{most.share:.0%} of the squares lie above the {bandwidth:g} Hz up to which it was "
        f"compared, most of it from {most.low:.3g} to {most.high:.3g} Hz: {shown}."
    )


def _bands(simulation: Simulation, recording: Recording, bandwidth: float) -> Iterator[_Band]:
    rate = recording.rate
    errors = recording.torque - simulation.predict(recording, bandwidth)
    for j in np.flatnonzero(recording.measured_joints).tolist():
        error = errors[np.isfinite(errors[:, j]), j]
        frequency, power = welch(error, rate, nperseg=min(len(error), round(ABOVE.window * rate)))
        above = frequency > bandwidth
        if above.any():
            yield _band(j, rate, frequency, np.where(above, power, 0.0), float(power.sum()))


def _band(j: int, rate: float, frequency: FloatArray, power: FloatArray, whole: float) -> _Band:
    """Return what stands out of a density of power (F,), which is zero up to the bandwidth."""
    usual = float(np.median(power[power > 0.0])) if (power > 0.0).any() else 0.0
    outstanding = np.where(power > ABOVE.outstanding * usual, power, 0.0)
    part = np.cumsum(outstanding) / max(float(outstanding.sum()), np.finfo(float).tiny)
    low, high = (frequency[np.argmax(part >= some)] for some in (1.0 - ABOVE.most, ABOVE.most))
    share = float(outstanding.sum()) / max(whole, np.finfo(float).tiny)
    return _Band(j + 1, share, float(low), float(high), rate)
