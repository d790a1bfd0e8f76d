"""One row of a fleet: a recording, the arm and the day it is of, and how its diagnosis ended."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from estimators.diagnosis.verdict import Verdict
    from estimators.fleet.tolerated import ToleratedValue

_DATE: Final = re.compile(
    r"(?<!\d)(\d{4})-?([01]\d)-?([0-3]\d)(?:[T_ -]?([0-2]\d)[-:.]?([0-5]\d)(?:[-:.]?([0-5]\d))?)?"
    r"(?!\d)"
)


@dataclass(frozen=True)
class FleetRow:
    """A recording of a fleet, and its verdict or the line that says why there is none."""

    recording: Path | str  # its file, or the URL of an object
    key: str  # of its bytes, the simulation and the version of limo; empty: it cannot be read
    arm: str  # the folder it lies in
    date: datetime | None  # in its path, if one is
    bytes: int = 0  # of the recording
    seconds: float = 0.0  # that its diagnosis took
    verdict: Verdict | None = None
    error: str = ""  # one line, where there is no verdict
    folder: Path | None = None  # of its diagnosis, with report.html
    tolerated: tuple[ToleratedValue, ...] = ()  # values that moved within their tolerances

    @property
    def diagnosed(self) -> bool:
        """Whether there is a verdict."""
        return self.verdict is not None


def arm_of(recording: Path | str) -> str:
    """Return the arm a recording is of: the name of the folder it lies in.

    Args:
        recording: File, or URL; `zip://arm3/a.csv::s3://...` lies in an archive.
    """
    place = Path(recording.split("::")[0]) if isinstance(recording, str) else recording
    return place.absolute().parent.name


def date_of(recording: Path | str) -> datetime | None:
    """Return the date, and the time of day if it is there, in the name or folder of a recording.

    Args:
        recording: For example `arm3/2026-03-01.parquet` or `arm3/20260301_1415.parquet`.

    Returns:
        The last one in the path that is a date; None without one. The time of the file is not
        taken for it: copying changes that.
    """
    for year, month, day, *clock in reversed(_DATE.findall(str(recording))):
        hour, minute, second = (int(item or 0) for item in clock)
        try:  # of a clock on the wall, which has no zone
            return datetime(int(year), int(month), int(day), hour, minute, second)
        except ValueError:  # digits that are no date
            continue
    return None
