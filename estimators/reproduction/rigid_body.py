"""The rigid body of the table: identified once from the excitation, and kept."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import TYPE_CHECKING, Final

import yaml

from estimators.reproduction.data import DESCRIPTION, RECORDINGS, ROBOT
from estimators.rigid_body import identify
from limo_driver.physics import Simulation

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.reproduction.data import TableData

_DIGITS: Final = 10  # of the digest in a file name


def rigid_body(data: TableData, folder: Path) -> Path:
    """Identify base parameters with Coulomb and viscous friction from the excitation.

    Args:
        data: Holds the excitation and names the robot.
        folder: Where the simulation is kept; one that is there already is taken.

    Returns:
        The sim.yaml.

    Raises:
        RecordingError: The excitation says too little.
    """
    of = (RECORDINGS[0], DESCRIPTION, ROBOT)
    known = "".join(data.digests[name] for name in of if name in data.digests)
    path = folder / f"rigid_body-{sha256(known.encode()).hexdigest()[:_DIGITS]}.yaml"
    if not path.exists():
        identify(data.model, [data.excitation]).simulation.save(path)
    return path


def physics_digest(simulation: Path) -> str:
    """Return the sha256 of what a sim.yaml says of inertias and joints, wherever its robot lies.

    Raises:
        ConfigError: It cannot be read, or is no simulation.
    """
    Simulation.load(simulation)  # refuses by name what is none
    content = yaml.safe_load(simulation.read_text(encoding="utf-8"))
    del content["robot"]  # a path relative to the file, which may have moved with its data
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
