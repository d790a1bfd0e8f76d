"""Settings of what is said of a fleet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class FleetSettings:
    """When an arm is odd, and when a series of values drifts."""

    arms: int = 4  # fewest among which one can be odd
    odd: float = 5.0  # robust standard deviations from the median arm
    least: float = 0.1  # relative difference or change below which nothing is said
    tolerance: float = 1.0  # times a value's tolerance: likewise, where the simulation states one
    told: float = 0.5  # of an arm's recordings, that have to tell such a value of it
    dates: int = 6  # fewest recordings with a date of which a trend is taken
    false_alarms: float = 0.01  # drifts expected by chance in a whole fleet without any
    worst: int = 10  # recordings listed


FLEET: Final = FleetSettings()
