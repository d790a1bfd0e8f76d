"""One diagnosis of a fleet as a row: its recording, and what was found."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from estimators.diagnosis.verdict import IMPROVED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.diagnosis.from_motion.pipeline import DriveDiagnosis
    from estimators.diagnosis.from_torque.pipeline import Diagnosis
    from estimators.diagnosis.verdict import Verdict
    from limo_driver.physics import Simulation

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


@dataclass(frozen=True)
class FleetSettings:
    """When an arm is odd, and when a series of values drifts."""

    arms: int = 4  # fewest among which one can be odd
    odd: float = 5.0  # robust standard deviations from the median arm
    least: float = 0.1  # relative difference or change below which nothing is said
    share: float = 0.5  # of an arm's recordings, that have to show a value of it
    dates: int = 6  # fewest recordings with a date of which a trend is taken
    known_dates: int = 4  # likewise, of values whose intervals are known
    false_alarms: float = 0.01  # drifts expected by chance in a whole fleet without any
    worst: int = 10  # recordings listed


FLEET: Final = FleetSettings()


@dataclass(frozen=True)
class FleetOutcome:
    """The files of a diagnosis, or the error of a recording that cannot be diagnosed."""

    seconds: float  # that it took
    error: str = ""  # one line, where there is no verdict
    files: Mapping[str, bytes] = field(default_factory=dict[str, bytes])  # by name
    simulation: Simulation | None = None  # improved; its file depends on where that will lie


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
    return FleetOutcome(seconds, files=files, simulation=found.simulation)
