"""How the diagnosis of one recording ended, as a value that crosses processes and machines."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from estimators.diagnosis.from_torque.diagnosis import Diagnosis
from estimators.diagnosis.verdict import IMPROVED
from estimators.fleet.tolerated import ToleratedValue, tolerated_values

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.diagnosis.from_motion.diagnosis import DriveDiagnosis
    from limo_driver.physics import Simulation


@dataclass(frozen=True)
class FleetOutcome:
    """The files of a diagnosis, or the error of a recording that cannot be diagnosed."""

    seconds: float  # that it took
    error: str = ""  # one line, where there is no verdict
    files: Mapping[str, bytes] = field(default_factory=dict[str, bytes])  # by name
    simulation: Simulation | None = None  # improved; its file depends on where that will lie
    tolerated: tuple[ToleratedValue, ...] = ()


def outcome_of(found: Diagnosis | DriveDiagnosis, seconds: float) -> FleetOutcome:
    """Return a diagnosis as what a fleet keeps of it.

    Args:
        found: The diagnosis.
        seconds: That it took.

    Raises:
        ConfigError: There is no room for its files on this machine.
        OSError: Likewise.
    """
    with TemporaryDirectory() as folder:
        found.save(folder)
        written = [path for path in sorted(Path(folder).iterdir()) if path.name != IMPROVED]
        files = {path.name: path.read_bytes() for path in written}
    tolerated = tolerated_values(found.shifts) if isinstance(found, Diagnosis) else ()
    return FleetOutcome(seconds, files=files, simulation=found.simulation, tolerated=tolerated)
