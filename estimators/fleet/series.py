"""Series: one quantity of a fleet, such as the error of a joint, over arms and dates."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from estimators.diagnosis.verdict import CONTACT, UNKNOWN
from limo_driver.physics import spoken

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping, Sequence
    from datetime import datetime

    from numpy.typing import NDArray

    from estimators.diagnosis.verdict import Verdict
    from estimators.fleet.row import FleetRow
    from limo_driver.types import FloatArray

_DAY: Final = 86_400.0  # [s]


@dataclass(frozen=True)
class Series:
    """One quantity, R values in the order of the recordings."""

    name: str  # e.g. "error of joint 3"
    unit: str
    ratio: bool  # compared as a ratio rather than a difference: errors are
    arms: tuple[str, ...]  # (R,)
    days: FloatArray  # (R,) since the first date of the fleet [days]; NaN without a date
    values: FloatArray  # (R,) [unit]
    tolerance: float = 0.0  # that the simulation states of the value [unit]; 0 of anything else
    recordings: Mapping[str, int] = field(default_factory=dict[str, int])  # of each arm, in all

    def compared(self) -> FloatArray:
        """Return the values in which differences count alike, (R,): logarithms of a ratio."""
        return np.log(np.maximum(self.values, 1e-300)) if self.ratio else self.values

    def of(self, arm: str) -> Series:
        """Return the values of one arm."""
        own = self._rows[arm]
        return Series(
            self.name,
            self.unit,
            self.ratio,
            (arm,) * own.size,
            self.days[own],
            self.values[own],
            self.tolerance,
            self.recordings,
        )

    def names(self) -> tuple[str, ...]:
        """Return the arms, each once, in order."""
        return tuple(self._rows)

    def told(self, arm: str) -> float:
        """Return the share of an arm's recordings that have a value."""
        return self._rows[arm].size / self.recordings.get(arm, self._rows[arm].size)

    @cached_property
    def _rows(self) -> dict[str, NDArray[np.intp]]:
        """Rows of each arm, found once: arm by arm it would take rows times arms."""
        arms, which = np.unique(np.array(self.arms), return_inverse=True)
        order = np.argsort(which, kind="stable")
        ends = np.cumsum(np.bincount(which))[:-1]
        return dict(zip(arms.tolist(), np.split(order, ends), strict=True))


def series_of(rows: Sequence[FleetRow]) -> tuple[Series, ...]:
    """Return the error of each joint, and each value of an effect found, identified or tolerated.

    Args:
        rows: Of a fleet; those without a verdict say nothing.
    """
    dated = [row.date for row in rows if row.diagnosed and row.date is not None]
    first = min(dated, default=None)
    found: dict[tuple[str, str, bool], list[tuple[str, float, float]]] = {}
    tolerances: dict[str, float] = {}
    for known in (value for row in rows for value in row.tolerated):
        tolerances[known.name] = max(known.tolerance, tolerances.get(known.name, 0.0))
    for row in rows:
        if row.verdict is None:
            continue
        day = _days(row.date, first)
        for name, unit, ratio, value in _quantities(row.verdict, tolerances):
            found.setdefault((name, unit, ratio), []).append((row.arm, day, value))
        for known in row.tolerated:
            found.setdefault((known.name, known.unit, False), []).append(
                (row.arm, day, known.value)
            )
    recordings = Counter(row.arm for row in rows if row.verdict is not None)
    return tuple(
        Series(
            *about,
            tuple(arm for arm, _, _ in items),
            np.array([day for _, day, _ in items]),
            np.array([value for _, _, value in items]),
            tolerances.get(about[0], 0.0),
            recordings,
        )
        for about, items in found.items()
    )


def _days(date: datetime | None, first: datetime | None) -> float:
    if date is None or first is None:
        return float("nan")
    return (date - first).total_seconds() / _DAY


def _quantities(
    verdict: Verdict, tolerated: Container[str]
) -> Iterator[tuple[str, str, bool, float]]:
    """Give name, unit, whether it is compared as a ratio, and value.

    A stated value that is found wrong goes on in the series of those within its tolerance: which of
    the two it is depends on nothing but how far it has moved.
    """
    for j, error in enumerate(verdict.fit.heldout_rmse_before, start=1):
        yield f"error of joint {j}", verdict.fit.unit, True, float(error)
    for item in (*verdict.findings, *verdict.identified):
        if item.effect in {CONTACT, UNKNOWN}:
            continue
        joints = ", ".join(map(str, item.joints))
        place = f" of joint {joints}" if joints else ""
        for name, known in item.parameters.items():
            stated = f"{name}{place} ({spoken(item.effect)})"
            for at, value in _numbers(known.value):
                own = f"{spoken(item.effect)}{place}: {name}{at}"
                yield stated if stated in tolerated else own, known.unit, False, value


def _numbers(value: object, at: str = "") -> Iterator[tuple[str, float]]:
    if isinstance(value, (tuple, list)):
        for k, item in enumerate(value, start=1):
            yield from _numbers(item, f"{at}[{k}]")
    elif isinstance(value, (int, float)) and np.isfinite(value):
        yield at, float(value)
