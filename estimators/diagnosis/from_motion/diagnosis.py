"""DriveDiagnosis: a result without torque that can be saved as a folder, with its report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from estimators.diagnosis.drive_result import DriveResult
from estimators.diagnosis.report.without_torque import drive_report
from estimators.diagnosis.verdict import IMPROVED, NEXT_MOTION, REPORT, VERDICT
from limo_driver.runtime.outputs import require_folder


@dataclass(frozen=True, repr=False)
class DriveDiagnosis(DriveResult):
    """Verdict, improved simulation and evidence of an arm that tells commands and positions."""

    def save(self, folder: Path | str) -> tuple[Path, ...]:
        """Write verdict.json, sim.yaml and report.html, and return their paths.

        Args:
            folder: Made if it is not there.

        Raises:
            ConfigError: The folder cannot be written to.
        """
        out = Path(folder)
        require_folder(out, "the diagnosis", (VERDICT, IMPROVED, REPORT, NEXT_MOTION))
        (out / NEXT_MOTION).unlink(missing_ok=True)
        self.verdict.save(out / VERDICT)
        self.after.save(out / IMPROVED)
        drive_report(self).save(out / REPORT)
        return out / VERDICT, out / IMPROVED, out / REPORT
