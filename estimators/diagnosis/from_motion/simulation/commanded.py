"""How far joints are told to move: where they are not, nothing of their drives shows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.from_motion.simulation.free_run import commands_of
from limo_driver.recordings.channels import TORQUE, VELOCITY, led_by

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray

MOVED: Final = 0.05  # [rad], range of its commands from which on a joint is identified
_ENOUGH: Final = 0.5  # [rad], beyond which more range says little more


def commanded_range(recordings: Sequence[Recording]) -> FloatArray:
    """Return the largest range of each joint's commands within a recording, (n,) [rad].

    Of velocities that are told [rad/s], that from rest: one that never changes moves a joint, too.
    Of torques, where there are any, how far the joint moved [rad].

    Args:
        recordings: With commands.
    """
    return np.max([_range(each) for each in recordings], axis=0)


def _range(recording: Recording) -> FloatArray:
    command = commands_of(recording)
    rest = np.where(led_by(VELOCITY, recording.channels), 0.0, command[0])
    told = np.ptp(np.vstack([command, rest]), axis=0)
    pushed = led_by(TORQUE, recording.channels)
    return np.where(pushed & command.any(axis=0), np.ptp(recording.position, axis=0), told)


def busiest(recordings: Sequence[Recording]) -> Recording:
    """Return the recording in which most joints are told to move.

    Args:
        recordings: With commands.
    """
    return max(recordings, key=lambda r: float(commanded_range([r]).clip(max=_ENOUGH).sum()))
