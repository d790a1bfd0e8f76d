"""What a fleet's series say: arms that are odd, joints that drift, and spread of unit to unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.stats import chi2, kendalltau, linregress, norm, t, theilslopes

from estimators.fleet.settings import FLEET

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.fleet.series import Series

_NORMAL: Final = float(1 / norm.ppf(0.75))  # standard deviation over median absolute deviation


@dataclass(frozen=True)
class ArmStanding:
    """How far one arm is from the others in one series."""

    arm: str
    series: Series
    z: float  # robust standard deviations from the median arm
    median: float  # of the arm's recordings [unit of the series]
    fleet: float  # median of all arms [unit]

    @property
    def odd(self) -> bool:
        """Whether the arm is the odd one out."""
        return abs(self.z) > FLEET.odd


@dataclass(frozen=True)
class FleetDrift:
    """A quantity of one arm that changes over dates."""

    arm: str
    series: Series  # of that arm
    change: float  # over the dates: relative for errors, else in the unit of the series
    interval: tuple[float, float]  # 95 %, of the change
    p: float  # of so clear a trend by chance


@dataclass(frozen=True)
class UnitSpread:
    """How units differ in one quantity."""

    series: Series
    arms: tuple[str, ...]  # (A,)
    means: tuple[float, ...]  # (A,) [unit], geometric for errors
    intervals: tuple[tuple[float, float], ...]  # (A,) 95 %; NaN of an arm with one recording
    deviation: float  # standard deviation between arms: relative for errors, else [unit]
    interval: tuple[float, float]  # 95 %


def drifts_of(series: Sequence[Series]) -> tuple[FleetDrift, ...]:
    """Return the quantities that change over dates, surest first.

    The trend is Theil and Sen's, and the surer of two tests says whether it is one, with a
    threshold that allows for both, and for how many series were tested. Kendall's does not mind
    values far from the rest, but knows order alone: seven values on a line are as sure to it as
    seven that rise anyhow. That of the regression line knows more.

    Args:
        series: Of all arms.

    Source: P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", 1968.
    """
    own = [item.of(arm) for item in series for arm in item.names()]
    tested = [item for item in own if np.isfinite(item.days).sum() >= FLEET.dates]
    found = [_drift(item) for item in tested if np.unique(item.days).size > 1]
    sure = [
        item
        for item in found
        if item.p < FLEET.false_alarms / len(tested) and _matters(item.change, item.series)
    ]
    return tuple(sorted(sure, key=lambda item: item.p))


def dates_of(own: Series) -> int:
    """Return how many different days the recordings of one arm have."""
    return np.unique(own.days[np.isfinite(own.days)]).size


def standings_of(series: Sequence[Series], drifts: Sequence[FleetDrift]) -> tuple[ArmStanding, ...]:
    """Return how far each arm is from the others in each series, farthest first.

    The scale is the median absolute deviation of the arms' medians, beside the least difference
    that matters, so that arms that agree closely do not make a small difference a large one. What
    drifts at an arm is said there, and does not make it odd, too. A value within its tolerance that
    only a few recordings of an arm tell is theirs and not the arm's.

    Args:
        series: Of all arms.
        drifts: That were found in them.
    """
    drifting = {(item.arm, item.series.name) for item in drifts}
    found: list[ArmStanding] = []
    for item in series:
        arms = [arm for arm in item.names() if not item.tolerance or item.told(arm) >= FLEET.told]
        if len(arms) < FLEET.arms:
            continue
        compared = [float(np.median(item.of(arm).compared())) for arm in arms]
        centre = float(np.median(compared))
        away = np.array(compared) - centre
        least = max(_least(item, centre), FLEET.tolerance * item.tolerance / FLEET.odd)
        scale = float(np.hypot(_NORMAL * np.median(np.abs(away)), least))
        found += [
            ArmStanding(arm, item, apart / scale, _unlogged(at, item), _unlogged(centre, item))
            for arm, at, apart in zip(arms, compared, away, strict=True)
            if scale > 0 and (arm, item.name) not in drifting
        ]
    return tuple(sorted(found, key=lambda item: -abs(item.z)))


def spreads_of(series: Sequence[Series]) -> tuple[UnitSpread, ...]:
    """Return how units differ, of every series that several arms have.

    Values within their tolerances are not among them: they are a hundred, and most never move.
    """
    several = [item for item in series if len(item.names()) > 1 and not item.tolerance]
    return tuple(map(_spread, several))


def _drift(own: Series) -> FleetDrift:
    dated = np.isfinite(own.days)
    days, values = own.days[dated], own.compared()[dated]
    trend: Any = theilslopes(values, days)
    over = float(np.ptp(days))
    change, *interval = (
        float(np.expm1(over * k) if own.ratio else over * k)
        for k in map(float, (trend.slope, trend.low_slope, trend.high_slope))
    )
    tests: tuple[Any, ...] = (kendalltau(days, values), linregress(days, values))
    surest = min(float(test.pvalue) for test in tests) if np.ptp(values) > 0 else 1.0
    p = min(1.0, len(tests) * surest)
    return FleetDrift(own.arms[0], own, change, (interval[0], interval[1]), p)


def _least(item: Series, centre: float) -> float:
    """Return the least difference that matters, of values as they are compared."""
    return float(np.log1p(FLEET.least)) if item.ratio else FLEET.least * abs(centre)


def _matters(change: float, own: Series) -> bool:
    size = 1.0 if own.ratio else abs(float(np.median(own.values)))
    return abs(change) > max(FLEET.least * size, FLEET.tolerance * own.tolerance)


def _spread(item: Series) -> UnitSpread:
    arms = item.names()
    own = [item.of(arm).compared() for arm in arms]
    means = np.array([values.mean() for values in own])
    half = np.array(
        [
            t.ppf(0.975, v.size - 1) * v.std(ddof=1) / np.sqrt(v.size) if v.size > 1 else np.nan
            for v in own
        ]
    )
    free = len(arms) - 1
    deviation = float(means.std(ddof=1))
    low, high = (deviation * float(np.sqrt(free / chi2.ppf(q, free))) for q in (0.975, 0.025))
    relative = np.expm1 if item.ratio else np.array
    return UnitSpread(
        item,
        arms,
        tuple(_unlogged(float(m), item) for m in means),
        tuple(
            (_unlogged(float(m - h), item), _unlogged(float(m + h), item))
            for m, h in zip(means, half, strict=True)
        ),
        float(relative(deviation)),
        (float(relative(low)), float(relative(high))),
    )


def _unlogged(value: float, item: Series) -> float:
    return float(np.exp(value)) if item.ratio else value
