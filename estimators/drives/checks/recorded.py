"""All that is checked of recordings with commands before anything is fitted to them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.drives.checks.commands import check_commands
from estimators.drives.checks.timing import check_timing
from estimators.drives.fitting.identification import with_servos
from estimators.recordings import check_different
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording


def check_commanded(simulation: Simulation, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Refuse recordings that say nothing of drives; tell what is odd about the others.

    Args:
        simulation: Of the arm; a joint without a drive is taken for one behind a usual servo.
        recordings: With commands.

    Returns:
        A sentence each: joints that stalled or moved without a command, delays that no joint has,
        rows that are missing.

    Raises:
        ConfigError: The simulation has an effect that cannot be run forward.
        RecordingError: There is none, one is of another robot or given twice, or its commands are
            no set-points of its joints in rad that came before the motion.
    """
    if not recordings:
        raise RecordingError("no recording with commands was given")
    for recording in recordings:
        recording.check_robot(simulation.model)
    check_different(recordings)
    odd = check_commands(recordings)
    return (*odd, *check_timing(with_servos(simulation), recordings))
