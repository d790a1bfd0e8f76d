"""Checks that every estimator makes of the recordings that it is fitted to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel
    from limo_driver.recordings.recording import Recording

_STILL: Final = 2e-3  # [rad], range of an arm that does not move


def check_recordings(recordings: Sequence[Recording], model: RobotModel) -> None:
    """Check that recordings are of the robot and say anything, and none the same as another.

    Raises:
        RecordingError: There is none, one is of another robot or given twice, nothing moves, or no
            torque was measured.
    """
    if not recordings:
        raise RecordingError("no recording to fit to")
    for recording in recordings:
        recording.check_robot(model)
    _check_torque(recordings)
    moved = max(float(np.ptp(recording.position, axis=0).max()) for recording in recordings)
    if moved < _STILL:
        raise RecordingError(
            f"no joint moves (range {moved:.2g} rad); an arm at rest reveals neither inertia nor "
            "friction",
            path=_sources(recordings),
        )
    for second, recording in enumerate(recordings):
        for first in recordings[:second]:
            if _same(first, recording):
                raise RecordingError(
                    f"holds the same samples as {first.source or 'another recording'}, and would "
                    "count as new evidence; give it once",
                    path=recording.source or None,
                )


def _check_torque(recordings: Sequence[Recording]) -> None:
    if not any(np.any(recording.torque) for recording in recordings):
        raise RecordingError("every torque is 0 N m; was it measured?", path=_sources(recordings))
    if not any(np.ptp(recording.torque, axis=0).any() for recording in recordings):
        raise RecordingError(
            "no torque ever changes, expected that of a moving arm; was it measured?",
            path=_sources(recordings),
        )


def _sources(recordings: Sequence[Recording]) -> str | None:
    return ", ".join(recording.source for recording in recordings if recording.source) or None


def _same(first: Recording, second: Recording) -> bool:
    return all(
        np.array_equal(getattr(first, name), getattr(second, name))
        for name in ("time", "position", "torque")
    )
