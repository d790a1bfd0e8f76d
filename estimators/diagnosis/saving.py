"""Save a diagnosis as a folder: verdict, improved simulation, report, and the next motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from estimators.diagnosis.report import write_report
from estimators.diagnosis.verdict import NEXT_MOTION
from limo_driver.errors import ConfigError
from limo_driver.outputs import require_folder

if TYPE_CHECKING:
    from estimators.diagnosis.result import Diagnosis

VERDICT: Final = "verdict.json"
IMPROVED: Final = "sim.yaml"
REPORT: Final = "report.html"
FILES: Final = (VERDICT, IMPROVED, REPORT, NEXT_MOTION)


def save(found: Diagnosis, folder: Path | str) -> None:
    """Write the files of a diagnosis; a next motion of one before it is removed.

    Args:
        found: What to save.
        folder: Made if it is not there.

    Raises:
        ConfigError: The folder cannot be written to.
    """
    out = Path(folder)
    require_folder(out, "the diagnosis", FILES)
    try:
        found.verdict.save(out / VERDICT)
        found.simulation.save(out / IMPROVED)
        write_report(found, out / REPORT)
        (out / NEXT_MOTION).unlink(missing_ok=True)
        if found.next_motion is not None:
            found.next_motion.save(out / NEXT_MOTION)
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error}", path=out) from None
