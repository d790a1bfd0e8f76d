"""Settings: what follows the verdict: the next motion, the replay, and bins of the report."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.diagnosis.settings.setting import setting

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@dataclass(frozen=True)
class SeparationSettings:
    """The motion in which two explanations differ (limo_driver.workflow.diagnosing)."""

    start_poses: int = setting(6, "poses", "of each recording, around which it is planned",
        "more cost time; fewer find worse motions, or none")


SEPARATION = SeparationSettings()


@dataclass(frozen=True)
class ReplaySettings:
    """Recorded motion on the simulated robot (limo_driver.workflow.diagnosing)."""

    duration: float = setting(12.0, "s", "of motion that is replayed, where it differs most",
        "more costs time; less shows less")
    many: int = setting(40, "effects", "of a simulation, beyond which the next value holds",
        "more cost time, since most are evaluated one by one in every cycle")
    duration_of_many: float = setting(5.0, "s", "the same, of a simulation of many effects",
        "as above")
    rate: float = setting(100.0, "Hz", "of the rows that are kept of it",
        "more make the report larger; fewer blur what is quick")


REPLAY = ReplaySettings()


@dataclass(frozen=True)
class BinSettings:
    """Bins and cells in which the report averages a residual (report.binning)."""

    rows: float = setting(10.0, "rows", "of a bin in the mean, where there are not enough for all",
        "more blur what the residual follows; fewer draw noise")
    most: int = setting(32, "bins", "of a profile", "more draw noise; fewer blur")
    most_over_time: int = setting(60, "bins", "of a profile over time", "as above")
    fewest: int = setting(5, "bins", "of a profile of however few rows",
        "more are empty; fewer say nothing")
    rows_of_cell: float = setting(3.0, "rows", "of a cell of a map in the mean, as for bins",
        "as above")
    most_cells: int = setting(22, "cells", "of a map, to either side",
        "more draw noise; fewer blur")
    fewest_cells: int = setting(6, "cells", "the same, of however few rows",
        "more are empty; fewer say nothing")
    shown: float = setting(0.25, "of the mean of bins with rows", "that a bin needs to be shown",
        "more leave out what the motion seldom does; fewer draw noise")
    enough: int = setting(8, "rows", "with which a bin is shown, however many others have",
        "as above")
    enough_of_cell: int = setting(4, "rows", "the same, of a cell of a map", "as above")
    least: int = setting(3, "rows", "without which neither is shown", "as above")


BINS = BinSettings()
