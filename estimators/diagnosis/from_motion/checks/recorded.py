"""All that is checked of recorded commands before anything is fitted to them, or simulated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from estimators.diagnosis.from_motion.checks.alone import check_alone
from estimators.diagnosis.from_motion.checks.commands import check_commands, check_set_points
from estimators.diagnosis.from_motion.checks.timing import check_timing
from estimators.diagnosis.from_motion.checks.torques import check_torques
from estimators.diagnosis.from_motion.fitting.identification import with_servos
from estimators.recordings import check_different
from limo_driver.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.physics import Simulation
    from limo_driver.recordings.commanded import Commanded
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
    given, led = with_servos(simulation, recordings)
    for recording in led:
        check_torques(given, recording)
    return (*check_commands(led), *check_timing(given, led))


def check_forward(simulation: Simulation, told: Commanded) -> tuple[str, ...]:
    """Refuse commands from which no motion should be simulated; tell what is odd about the others.

    They are held against the motion that was recorded, by the same rules as where that is fitted
    to, but that they may rest. Nothing but the first position of it gets into the simulation.

    Args:
        simulation: With a drive for each joint.
        told: The commands.

    Raises:
        RecordingError: They are of another robot, or no set-points of its joints in rad that came
            before the motion.
    """
    told.check_robot(simulation.model)
    simulation = simulation.with_motors(told.channels)
    told = told.led(simulation.channels)
    if told.recorded is None:
        return check_alone(simulation.model, told)
    told.recorded.check_robot(simulation.model)
    check_torques(simulation, told.recorded)
    odd = check_set_points([told.recorded])
    return (*odd, *check_timing(simulation, [told.recorded]))
