"""The rigid body of the table: identified once from the excitation, and kept."""

from __future__ import annotations

from hashlib import sha256
from typing import TYPE_CHECKING, Final

from estimators.reproduction.data import DESCRIPTION, RECORDINGS
from estimators.rigid_body import identify

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.reproduction.data import TableData

_DIGITS: Final = 10  # of the digest in a file name


def rigid_body(data: TableData, folder: Path) -> Path:
    """Identify base parameters with Coulomb and viscous friction from the excitation.

    Args:
        data: Holds the excitation.
        folder: Where the simulation is kept; one that is there already is taken.

    Returns:
        The sim.yaml.

    Raises:
        RecordingError: The excitation says too little.
    """
    known = "".join(data.digests[name] for name in (RECORDINGS[0], DESCRIPTION))
    path = folder / f"rigid_body-{sha256(known.encode()).hexdigest()[:_DIGITS]}.yaml"
    if not path.exists():
        partial = path.with_name(f".{path.name}.partial")
        identify(data.model, [data.excitation]).simulation.save(partial)
        partial.replace(path)
    return path
