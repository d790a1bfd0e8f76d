"""Settings: what follows the verdict: the next motion, the replay, and what is shown and said."""

from __future__ import annotations

from estimators.diagnosis.settings import setting, settings

# A table: value, unit, meaning; what it trades; how it was chosen.
# fmt: off


@settings
class SEPARATION:
    """The motion in which two explanations differ (limo_driver.app.library.diagnosing)."""

    start_poses: int = setting(6, "poses", "of each recording, around which it is planned",
        "more cost time; fewer find worse motions, or none")


@settings
class REPLAY:
    """Recorded motion on the simulated robot (limo_driver.app.library.diagnosing)."""

    duration: float = setting(12.0, "s", "of motion that is replayed, where it differs most",
        "more costs time; less shows less")
    many: int = setting(40, "effects", "of a simulation, beyond which the next value holds",
        "more cost time, since most are evaluated one by one in every cycle")
    duration_of_many: float = setting(5.0, "s", "the same, of a simulation of many effects",
        "as above")
    rate: float = setting(100.0, "Hz", "of the rows that are kept of it",
        "more make the report larger; fewer blur what is quick")


@settings
class BINS:
    """Bins and cells in which the report averages a residual (report.binning)."""

    rows: float = setting(10.0, "rows", "of a bin in the mean, where there are not enough for all",
        "more blur what the residual follows; fewer draw noise")
    most: int = setting(32, "bins", "of a profile", "more draw noise; fewer blur")
    fewest: int = setting(5, "bins", "of a profile of however few rows",
        "more are empty; fewer say nothing")
    most_cells: int = setting(22, "cells", "of a map, to either side",
        "more draw noise; fewer blur")
    shown: float = setting(0.25, "of the mean of bins with rows", "that a bin needs to be shown",
        "more leave out what the motion seldom does; fewer draw noise")
    enough: int = setting(8, "rows", "with which a bin is shown, however many others have",
        "as above")
    brightest: float = setting(98.0, "percentile", "of the cells of a map, at which colours end",
        "higher leaves the map pale; lower shows differences of large cells no more")


@settings
class LOOPS:
    """Loops of torque over position that the report shows (report.stretch)."""

    duration: float = setting(8.0, "s", "of motion drawn as loops",
        "longer covers them with other loops; shorter shows part of one")


@settings
class WORDING:
    """What is worth a word (headline, wording, verdict, report)."""

    pushes: int = setting(2, "pushes", "whose times a headline says", "only wording")
    listed: int = setting(3, "items", "that a sentence names, or a page shows at once",
        "only wording")
    beyond_doubt: float = setting(1e6, "to 1", "odds beyond which a figure says no more than words",
        "only wording")
    worse: float = setting(1.05, "times the given simulation's",
        "error from which on it is called worse", "only wording: higher marks less")
    at_floor: float = setting(1.15, "noise floors", "up to which an error is at the floor",
        "only wording: higher calls small errors noise",
        chosen="the floor is an estimate itself")
    from_start: float = setting(1.0, "s", "after a free run begins, from which on that is asked",
        "longer leaves less to ask; shorter takes what an unknown start makes for physics")
    explanations: int = setting(12, "sets", "of effects that are listed as having competed",
        "more make the report longer; fewer hide how near others came")
