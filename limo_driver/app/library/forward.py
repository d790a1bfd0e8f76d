"""Motion that is simulated forward from recorded commands alone."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from limo_driver.app.library.inputs import recording_of, simulation_of
from limo_driver.app.library.reading import read_commanded
from limo_driver.recordings.commanded import Commanded

if TYPE_CHECKING:
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording
    from limo_driver.types import FloatArray


@dataclass(frozen=True)
class ForwardMotion:
    """What a simulated arm made of commands."""

    told: Commanded
    position: FloatArray  # (T, n) [rad], as the encoders would read it
    warnings: tuple[str, ...]  # what makes one doubt the commands


def predict_forward(
    simulation: Simulation | Path | str, recording: Recording | Commanded | Path | str
) -> FloatArray:
    """Simulate a recorded motion forward from its commands alone, without looking at the rest.

    Args:
        simulation: With drives; or its file.
        recording: T samples of n joints with commands, or its file, of which all rows with a time
            and commands count. The simulated arm starts at rest at the first recorded position;
            the last command before a gap stays in force.

    Returns:
        Positions (T, n) [rad].

    Raises:
        ConfigError: A joint has no drive, or an effect cannot be run forward.
        RecordingError: The recording has no commands or no first position, is of another robot, or
            its commands are no set-points in rad: held against the recorded motion where there is
            one.

    Example:
        >>> limo.predict_forward("servos.yaml", "commanded.parquet")
    """
    return simulate_forward(simulation_of(simulation), recording).position


def simulate_forward(
    simulation: Simulation, recording: Recording | Commanded | Path | str
) -> ForwardMotion:
    """Do as `predict_forward` does, and return the rows as well, and what is odd about them."""
    from estimators.diagnosis.from_motion import commanded_run
    from estimators.diagnosis.from_motion.checks.recorded import check_forward

    if isinstance(recording, (Path, str)):
        told = read_commanded(recording, simulation.model)
    elif isinstance(recording, Commanded):
        told = recording
    else:
        told = Commanded.of(recording_of(recording))
    odd = check_forward(simulation, told)
    return ForwardMotion(told, commanded_run(simulation, told), odd)
