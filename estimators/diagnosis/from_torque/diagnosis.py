"""Diagnosis: a result that can be saved as a folder, with its report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from estimators.diagnosis.report import write_report
from estimators.diagnosis.result import DiagnosisResult
from estimators.diagnosis.stages import Failure
from estimators.diagnosis.verdict import IMPROVED, NEXT_MOTION, REPORT, VERDICT
from limo_driver.errors import ConfigError, LimoError
from limo_driver.runtime.outputs import require_folder

FILES: Final = (VERDICT, IMPROVED, REPORT, NEXT_MOTION)


def save(found: Diagnosis, folder: Path | str) -> tuple[Diagnosis, tuple[Path, ...]]:
    """Write the files of a diagnosis; those of one before it that are not written are removed.

    Verdict, simulation and next motion are there before the report is made. Where that fails, the
    verdict is written once more, with a note.

    Args:
        found: What to save.
        folder: Made if it is not there.

    Returns:
        The diagnosis, with the failure of its report if that failed, and the files written.

    Raises:
        ConfigError: The folder cannot be written to.
    """
    out = Path(folder)
    require_folder(out, "the diagnosis", FILES)
    written = [out / VERDICT, out / IMPROVED]
    try:
        found.verdict.save(out / VERDICT)
        found.simulation.save(out / IMPROVED)
        (out / NEXT_MOTION).unlink(missing_ok=True)
        if found.next_motion is not None:
            found.next_motion.save(out / NEXT_MOTION)
            written.append(out / NEXT_MOTION)
        try:
            write_report(found, out / REPORT)
            written.append(out / REPORT)
        except (LimoError, OSError):  # nothing can be written, a verdict as little
            raise
        except Exception as error:  # noqa: BLE001  # whatever it is, the verdict is known
            (out / REPORT).unlink(missing_ok=True)
            found = found.failed(Failure("report", error))
            found.verdict.save(out / VERDICT)
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error}", path=out) from None
    return found, tuple(written)


@dataclass(frozen=True, repr=False)
class Diagnosis(DiagnosisResult):
    """Result of a diagnosis: verdict, improved simulation, and evidence."""

    def save(self, folder: Path | str) -> None:
        """Write verdict.json, sim.yaml, report.html, and next_motion.parquet if there is one.

        Where the report fails, the others are written all the same, and the verdict says so.

        Args:
            folder: Made if it is not there.

        Raises:
            ConfigError: The folder cannot be written to.
            Exception: What the report failed with.
        """
        saved, _ = save(self, folder)
        for failure in saved.failures[len(self.failures) :]:
            raise failure.error
