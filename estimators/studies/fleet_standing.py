"""What a fleet's series say: arms that are odd, joints that drift, and spread of unit to unit."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.stats import chi2, kendalltau, linregress, norm, t, theilslopes

from estimators.diagnosis.quantities import QUANTITIES
from estimators.studies.fleet_row import FLEET
from limo_driver.runtime.display import joint_called

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from datetime import datetime

    from numpy.typing import NDArray

    from estimators.diagnosis.verdict import Verdict
    from estimators.studies.fleet_row import FleetRow
    from limo_driver.types import FloatArray

_NORMAL: Final = float(1 / norm.ppf(0.75))  # standard deviation over median absolute deviation
_DAY: Final = 86_400.0  # [s]
_NONE: Final = (0.0, 0.0, 0.0)  # of what a recording does not find to be missing
_SMALLEST: Final = 1e-300  # in place of nothing, where one divides by it


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

    def __str__(self) -> str:
        """Return the arm's value, and that of the others."""
        value = f"{self.median:.3g} {self.series.unit}"
        return f"{self.series.name} is {value} where the fleet has {self.fleet:.3g}"


@dataclass(frozen=True)
class FleetDrift:
    """A quantity of one arm that changes over dates."""

    arm: str
    series: Series  # of that arm
    change: float  # over the dates: relative for errors, else in the unit of the series
    interval: tuple[float, float]  # 95 %, of the change
    p: float  # of so clear a trend by chance
    ends: tuple[float, float]  # of the trend, at the first date and at the last [unit]

    @property
    def size(self) -> float:
        """How many times the least change that matters it is."""
        return abs(self.change) / _least_change(self.series)

    def __str__(self) -> str:
        """Return from what to what it changed."""
        first, last = self.ends
        verb = "rose" if last > first else "fell"
        change = f"from {first:.3g} to {last:.3g} {self.series.unit}"
        return f"{self.series.name} {verb} {change} between the first and the last date"


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
    """Return the quantities that change over dates, what changes most first.

    The trend is Theil and Sen's, and the surer of two tests says whether it is one, with a
    threshold that allows for both, and for how many series were tested. Kendall's does not mind
    values far from the rest, but knows order alone: seven values on a line are as sure to it as
    seven that rise anyhow. That of the regression line knows more. Where the intervals of all
    values are known, it decides from a few dates on, and takes no value for surer than they say:
    so few can lie close to a line by chance.

    Args:
        series: Of all arms.

    Source: P. K. Sen, "Estimates of the regression coefficient based on Kendall's tau", 1968.
    """
    own = [item.of(arm) for item in series for arm in item.names()]
    enough = [FLEET.known_dates if (item.halves > 0).all() else FLEET.dates for item in own]
    dated = [np.isfinite(item.days).sum() for item in own]
    tested = [x for x, many, most in zip(own, dated, enough, strict=True) if many >= most]
    found = [_drift(item) for item in tested if np.unique(item.days).size > 1]
    sure = [item for item in found if item.p < FLEET.false_alarms / len(tested) and item.size > 1.0]
    return tuple(sorted(sure, key=lambda item: -item.size))


def dates_of(own: Series) -> int:
    """Return how many different days the recordings of one arm have."""
    return np.unique(own.days[np.isfinite(own.days)]).size


def most_moved(series: Sequence[Series]) -> Series | None:
    """Return the values of one arm that differ most between dates; None without two dates."""
    own = [item.of(arm) for item in series for arm in item.names()]

    def moved(one: Series) -> float:
        return float(np.ptp(one.compared()[np.isfinite(one.days)])) / _least_change(one)

    return max((one for one in own if dates_of(one) > 1), key=moved, default=None)


def few_dates(series: Sequence[Series]) -> str:
    """Say that the arms have too few dates to show all drifts, or nothing if they have enough."""
    most = max((dates_of(item.of(arm)) for item in series for arm in item.names()), default=0)
    if most >= FLEET.dates:
        return ""
    have = "no recording has a date" if not most else f"no arm has more than {most} dates"
    return (
        f"{have}: a drift takes {FLEET.dates}, or from {FLEET.known_dates} on values with "
        "intervals that rise or fall evenly"
    )


def standings_of(series: Sequence[Series], drifts: Sequence[FleetDrift]) -> tuple[ArmStanding, ...]:
    """Return how far each arm is from the others in each series, farthest first.

    The scale is the median absolute deviation of the arms' medians, with the least difference
    that matters, which counts less the more arms say how units differ. A difference below that,
    or the value's tolerance, makes no arm odd, however closely the others agree. What
    drifts at an arm is said there, and does not make it odd, too. A value that only a few
    recordings of an arm tell is theirs and not the arm's.

    Args:
        series: Of all arms.
        drifts: That were found in them.
    """
    drifting = {(item.arm, item.series.name) for item in drifts}
    found: list[ArmStanding] = []
    for item in series:
        arms = [arm for arm in item.names() if item.share(arm) >= FLEET.share]
        if len(arms) < FLEET.arms:
            continue
        compared = [float(np.median(item.of(arm).compared())) for arm in arms]
        centre = float(np.median(compared))
        away = np.array(compared) - centre
        least = _least(item, centre)
        unsure = least * np.sqrt(FLEET.arms / len(arms))
        smallest = max(least, item.tolerance) / FLEET.odd
        scale = max(float(np.hypot(_NORMAL * np.median(np.abs(away)), unsure)), smallest)
        found += [
            ArmStanding(arm, item, apart / scale, _unlogged(at, item), _unlogged(centre, item))
            for arm, at, apart in zip(arms, compared, away, strict=True)
            if scale > 0 and (arm, item.name) not in drifting
        ]
    return tuple(sorted(found, key=lambda item: -abs(item.z)))


def spreads_of(series: Sequence[Series]) -> tuple[UnitSpread, ...]:
    """Return how units differ, of every series that several arms have."""
    return tuple(_spread(item) for item in series if len(item.names()) > 1)


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
    chances = [float(test.pvalue) if np.ptp(values) > 0 else 1.0 for test in tests]
    if days.size < FLEET.dates:
        line, spread = tests[1], np.sqrt(np.mean(own.halves[dated] ** 2)) / norm.ppf(0.975)
        error = max(line.stderr, spread / np.linalg.norm(days - days.mean()))
        chances = [1.0, 2.0 * float(t.sf(abs(line.slope) / error, days.size - 2))]
    p = min(1.0, len(tests) * min(chances))
    first, last = (
        _unlogged(trend.intercept + trend.slope * at, own) for at in (days.min(), days.max())
    )
    return FleetDrift(own.arms[0], own, change, (interval[0], interval[1]), p, (first, last))


def _least(item: Series, centre: float) -> float:
    """Return the least difference that matters, of values as they are compared."""
    return float(np.log1p(FLEET.least)) if item.ratio else FLEET.least * abs(centre)


def _least_change(own: Series) -> float:
    size = 1.0 if own.ratio else abs(float(np.median(own.values)))
    return max(FLEET.least * size, own.tolerance, _SMALLEST)


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


@dataclass(frozen=True)
class Series:
    """One quantity, R values in the order of the recordings."""

    name: str  # e.g. "error of joint 3"
    unit: str
    ratio: bool  # compared as a ratio rather than a difference: errors are
    arms: tuple[str, ...]  # (R,)
    days: FloatArray  # (R,) since the first date of the fleet [days]; NaN without a date
    values: FloatArray  # (R,) [unit]
    halves: FloatArray  # (R,) half of the 95 % interval of each [unit]; 0 where none is known
    tolerance: float = 0.0  # of the value, or half of its 95 % interval [unit]; 0 of an error
    recordings: Mapping[str, int] = field(default_factory=dict[str, int])  # of each arm, in all

    def compared(self) -> FloatArray:
        """Return the values in which differences count alike, (R,): logarithms of a ratio."""
        return np.log(np.maximum(self.values, _SMALLEST)) if self.ratio else self.values

    def of(self, arm: str) -> Series:
        """Return the values of one arm."""
        own = self._rows[arm]
        of_rows = {name: getattr(self, name)[own] for name in ("days", "values", "halves")}
        return replace(self, arms=(arm,) * own.size, **of_rows)

    def names(self) -> tuple[str, ...]:
        """Return the arms, each once, in order."""
        return tuple(self._rows)

    def share(self, arm: str) -> float:
        """Return the share of an arm's recordings that have a value."""
        return self._rows[arm].size / self.recordings.get(arm, self._rows[arm].size)

    @cached_property
    def _rows(self) -> dict[str, NDArray[np.intp]]:
        """Rows of each arm, found once: arm by arm it would take rows times arms."""
        arms, which = np.unique(np.array(self.arms), return_inverse=True)
        order = np.argsort(which, kind="stable")
        ends = np.cumsum(np.bincount(which))[:-1]
        return dict(zip(arms.tolist(), np.split(order, ends), strict=True))


def series_of(rows: Sequence[FleetRow], joints: Sequence[str] = ()) -> tuple[Series, ...]:
    """Return the error of each joint, and each quantity of it, whatever effect it was found as.

    What a simulation states, or every joint has some of, has a value where a recording shows it
    well. What fewer than half of the recordings find to be missing, as a payload, is 0 elsewhere.

    Args:
        rows: Of a fleet; those without a verdict say nothing.
        joints: Their names.
    """
    judged = [(row, row.verdict) for row in rows if row.verdict is not None]
    first = min((row.date for row, _ in judged if row.date is not None), default=None)
    found: dict[tuple[str, str, bool], dict[int, tuple[float, float, float]]] = {}
    ordinary: set[tuple[str, str, bool]] = set()
    for k, (_, verdict) in enumerate(judged):
        for about, value, half, tolerance, is_ordinary in _quantities(verdict, joints):
            if value is not None:
                found.setdefault(about, {}).setdefault(k, (value, half, tolerance))
            if is_ordinary:
                ordinary.add(about)
    recordings = Counter(row.arm for row, _ in judged)
    series: list[Series] = []
    for about, values in found.items():
        rare = about not in ordinary and len(values) < len(judged) / 2
        known = [k for k in range(len(judged)) if rare or k in values]
        series.append(
            Series(
                *about,
                tuple(judged[k][0].arm for k in known),
                np.array([_days(judged[k][0].date, first) for k in known]),
                np.array([values.get(k, _NONE)[0] for k in known]),
                np.array([values.get(k, _NONE)[1] for k in known]),
                float(np.median([tolerance for *_, tolerance in values.values()])),
                recordings,
            )
        )
    return tuple(series)


def _days(date: datetime | None, first: datetime | None) -> float:
    if date is None or first is None:
        return float("nan")
    return (date - first).total_seconds() / _DAY


def _quantities(
    verdict: Verdict, joints: Sequence[str]
) -> Iterator[tuple[tuple[str, str, bool], float | None, float, float, bool]]:
    """Give name, unit, if a ratio; value, half of its interval, tolerance; if it is ordinary.

    Settings that only serve a fit, such as the width of a sign function, are no quantities.
    """
    for j, error in enumerate(verdict.fit.heldout_rmse_before, start=1):
        yield (f"error{_of((j,), joints)}", verdict.fit.unit, True), float(error), 0.0, 0.0, True
    for item in verdict.values:
        if name := QUANTITIES.get((item.effect, item.name)):
            about = (f"{name}{_of(item.joints, joints)}", item.unit, False)
            known = item.fitted if item.is_known_well or item.beyond else None
            half = _half(item.ci95)
            yield about, known, half, item.tolerance or half, True
    for item in (*verdict.findings, *verdict.identified):
        for parameter, known in item.parameters.items():
            name, value = QUANTITIES.get((item.effect, parameter)), known.value
            if name and isinstance(value, (int, float)) and np.isfinite(value):
                place = _of(item.joints, joints) if item.effect != "payload" else ""
                is_ordinary = item in verdict.identified
                about = (f"{name}{place}", known.unit, False)
                half = _half(known.ci95)
                yield about, float(value), half, half, is_ordinary


def _of(on: Sequence[int], joints: Sequence[str]) -> str:
    called = [joint_called(j, joints[j - 1]) if joints else str(j) for j in on]
    return f" of joint {', '.join(called)}" if called else ""


def _half(ci95: tuple[Any, ...] | None) -> float:
    return abs(ci95[1] - ci95[0]) / 2 if ci95 else 0.0
