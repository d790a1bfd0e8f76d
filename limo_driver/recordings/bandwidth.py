"""The bandwidth of filters where none is told: one for all that compares motion and torque."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from limo_driver.recordings.filters.differentiation import HIGHEST_BANDWIDTH, SAFE_BANDWIDTH

if TYPE_CHECKING:
    from collections.abc import Iterable

    from limo_driver.recordings.recording import Recording

BANDWIDTH: Final = 10.0  # [Hz] of the zero-phase filters on motion and torque
_STEPS: Final = 20.0  # [1/Hz], to which a lower one is rounded down, to be told and typed again


def bandwidth_for(
    recordings: Iterable[Recording], asked: float | None = None, found: float | None = None
) -> float:
    """Return the bandwidth at which recordings are filtered together [Hz].

    Args:
        recordings: With their sampling rates.
        asked: What a user told; then it is this, whether it suits them or not.
        found: That of a simulation, which takes the place of the usual one.

    Returns:
        The usual 10 Hz, or as much as the most slowly sampled recording can bear.
    """
    if asked is not None:
        return asked
    slowest = min((one.slowest_rate for one in recordings), default=float("inf"))
    return bandwidth_at(slowest, BANDWIDTH if found is None else found)


def bandwidth_at(rate: float, usual: float = BANDWIDTH) -> float:
    """Return the usual bandwidth, or as much as samples at a rate [Hz] can bear."""
    if rate * HIGHEST_BANDWIDTH >= usual:
        return usual
    bearable = SAFE_BANDWIDTH * rate
    return max(int(bearable * _STEPS) / _STEPS, min(bearable, 1.0 / _STEPS))


def about_lower_bandwidth(recordings: Iterable[Recording], bandwidth: float) -> str | None:
    """Say that recordings are compared below the usual bandwidth since they bear no more, if so.

    Args:
        recordings: With their sampling rates.
        bandwidth: At which they are filtered [Hz].
    """
    slowest = min(recordings, key=lambda one: one.slowest_rate, default=None)
    if slowest is None or bandwidth != bandwidth_for([slowest]) or bandwidth == BANDWIDTH:
        return None
    return (
        f"Motion and torque are compared up to {bandwidth:g} Hz instead of {BANDWIDTH:g} Hz, since "
        f"{slowest.source or 'a recording'} is sampled at {slowest.slowest_rate:.3g} Hz in places: "
        "what is faster is not seen."
    )
