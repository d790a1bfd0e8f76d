"""Noise of motion: up to which frequency a recorded motion still tells the torque of the bodies.

An acceleration is the second derivative of positions, and their noise grows in it with the square
of the frequency. Where the bodies of a simulation would need far more torque at the upper end of
what is compared than was measured there, that is noise. It would be taken for errors of the torque,
and what makes a prediction smaller there, such as a lag, for physics.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from estimators.diagnosis.settings.residuals import MOTION, ROWS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


def clear_bandwidth(
    simulation: Simulation, recordings: Sequence[Recording], bandwidth: float
) -> float:
    """Return the bandwidth up to which motion tells the torque of the bodies, at most a given one.

    Args:
        simulation: What is believed of the arm.
        recordings: Of that arm, with torques.
        bandwidth: That they can bear [Hz].

    Returns:
        The given bandwidth, halved as long as its upper half is noise and enough rows stay [Hz].

    Raises:
        RecordingError: A recording is of another robot.
    """
    for recording in recordings:
        recording.check_robot(simulation.model)
    seconds = sum(len(recording) / recording.rate for recording in recordings)
    while (
        ROWS.per_bandwidth * bandwidth / 2.0 * seconds >= MOTION.rows
        and bandwidth / 2.0 >= MOTION.lowest
        and _noisy(simulation, recordings, bandwidth)
    ):
        bandwidth /= 2.0
    return bandwidth


def lowered_for(bandwidth: float, usual: float) -> str:
    """Say that recordings are compared at a lower bandwidth [Hz] than they could bear."""
    return (
        f"Motion and torque are compared up to {bandwidth:g} Hz instead of {usual:g} Hz: what the "
        "bodies would need above it is mostly noise of the positions. What is faster is not seen."
    )


def _noisy(simulation: Simulation, recordings: Sequence[Recording], bandwidth: float) -> bool:
    """Say whether the upper half of a bandwidth [Hz] is noise at a third of the joints or more.

    Those of the wrist carry too little to show it.
    """
    bodies = replace(simulation, effects=())
    needed, measured, error = (np.zeros(bodies.model.n) for _ in range(3))
    counts = np.zeros(bodies.model.n, dtype=bool)
    for recording in recordings:
        inner = ~recording.edges(bandwidth / 2.0)
        motion = recording.motion(bandwidth)
        needed += _upper_half(recording, bodies.predict(motion), bandwidth)[inner].sum(axis=0)
        measured += _upper_half(recording, recording.torque, bandwidth)[inner].sum(axis=0)
        left = recording.filtered(recording.torque - simulation.predict(motion), bandwidth)
        error += np.var(left[inner], axis=0) * inner.sum()
        counts |= np.ptp(recording.position, axis=0) > MOTION.travel
    noisy = (needed > MOTION.noise * measured) & (needed > MOTION.matters * error)
    return bool(MOTION.joints * np.sum(counts) <= np.sum(noisy & counts) > 0)


def _upper_half(recording: Recording, torque: FloatArray, bandwidth: float) -> FloatArray:
    """Return the power of torques (T, n) between half a bandwidth and all of it [N² m²]."""
    band = recording.filtered(torque, bandwidth) - recording.filtered(torque, bandwidth / 2.0)
    return band**2
