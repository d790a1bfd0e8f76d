"""The result of a fleet: its rows, and what they say together."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Final

from estimators.fleet.series import series_of
from estimators.fleet.settings import FLEET
from estimators.fleet.standing import drifts_of, spreads_of, standings_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from estimators.fleet.row import FleetRow
    from estimators.fleet.series import Series
    from estimators.fleet.standing import ArmStanding, FleetDrift, UnitSpread

_NAMED: Final = 4  # arms in a headline


@dataclass(frozen=True)
class FleetDiagnosis:
    """The rows of a fleet, in the order of their recordings, and what they say together."""

    robot: str
    rows: tuple[FleetRow, ...]
    set_aside: Mapping[str, int] = field(default_factory=dict[str, int])  # rows by other versions

    @cached_property
    def series(self) -> tuple[Series, ...]:
        """Errors and values over arms and dates."""
        return series_of(self.rows)

    @cached_property
    def drifts(self) -> tuple[FleetDrift, ...]:
        """What changes over dates, surest first."""
        return drifts_of(self.series)

    @cached_property
    def standings(self) -> tuple[ArmStanding, ...]:
        """How far each arm is from the others, farthest first."""
        return standings_of(self.series, self.drifts)

    @cached_property
    def spreads(self) -> tuple[UnitSpread, ...]:
        """How units differ in each quantity."""
        return spreads_of(self.series)

    @property
    def odd(self) -> tuple[str, ...]:
        """Arms that are the odd ones out, the oddest first."""
        return tuple(dict.fromkeys(item.arm for item in self.standings if item.odd))

    @property
    def drifting(self) -> tuple[str, ...]:
        """Arms of which something drifts, the surest first."""
        return tuple(dict.fromkeys(item.arm for item in self.drifts))

    @property
    def failed(self) -> tuple[FleetRow, ...]:
        """Rows without a verdict."""
        return tuple(row for row in self.rows if not row.diagnosed)

    @property
    def headline(self) -> str:
        """Say in one sentence which arms are odd, and which drift."""
        told = [
            f"{what}: {', '.join(arms[:_NAMED])}"
            + (f" and {len(arms) - _NAMED} more" if len(arms) > _NAMED else "")
            for what, arms in (("odd", self.odd), ("drifting", self.drifting))
            if arms
        ]
        if told:
            sentence = "; ".join(told)
            return f"{sentence[0].upper()}{sentence[1:]}"
        if not self.standings:
            return f"Fewer than {FLEET.arms} arms: none can be told from the others"
        return "No arm is odd, and no drift shows"

    def __str__(self) -> str:
        arms = len({row.arm for row in self.rows if row.diagnosed})
        done = len(self.rows) - len(self.failed)
        lines = [f"{done} of {len(self.rows)} recordings diagnosed, of {arms} arms."]
        for other, count in self.set_aside.items():
            lines.append(f"set aside: {count} diagnoses by limo {other}, not of this version")
        seen: set[str] = set()
        for item in self.standings:
            if item.odd and item.arm not in seen:
                seen.add(item.arm)
                lines.append(
                    f"odd: {item.arm}, {item.series.name} {item.median:.3g} {item.series.unit} "
                    f"where the fleet has {item.fleet:.3g} (z = {item.z:+.1f})"
                )
        told: set[str] = set()
        for item in self.drifts:
            if item.arm not in told:
                told.add(item.arm)
                lines.append(f"drifting: {item.arm}, {item.series.name} {changed(item)}")
        if not seen and not told:
            odd = "no arm is odd" if self.standings else f"no arm of fewer than {FLEET.arms} is odd"
            lines.append(f"{odd}, and no drift shows")
        return "\n".join(lines)


def changed(item: FleetDrift) -> str:
    """Say how much a quantity changed over its dates, with the interval of 95 %."""
    low, high = item.interval
    if item.series.ratio:
        return f"{100 * item.change:+.0f} % ({100 * low:+.0f} to {100 * high:+.0f} %)"
    return f"{item.change:+.3g} ({low:+.3g} to {high:+.3g}) {item.series.unit}"
