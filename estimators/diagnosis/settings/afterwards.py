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


@settings
class LOOPS:
    """Loops of torque over position that the report shows (report.stretch)."""

    duration: float = setting(8.0, "s", "of motion drawn as loops",
        "longer covers them with other loops; shorter shows part of one")


@settings
class WORDING:
    """What is worth a word (headline, wording, verdict, report)."""

    listed: int = setting(3, "items", "that a sentence names, or a page shows at once",
        "only wording")
    beyond_doubt: float = setting(1e6, "to 1", "odds beyond which a figure says no more than words",
        "only wording")
    at_floor: float = setting(1.15, "noise floors", "up to which an error is at the floor",
        "only wording: higher calls small errors noise",
        chosen="the floor is an estimate itself")
    from_start: float = setting(1.0, "s", "after a free run begins, from which on that is asked",
        "longer leaves less to ask; shorter takes what an unknown start makes for physics")
    explanations: int = setting(12, "sets", "of effects that are listed as having competed",
        "more make the report longer; fewer hide how near others came")
