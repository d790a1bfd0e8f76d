"""Values that a recording moves within the tolerance that a simulation states of them.

Such a move is no finding: the simulation allows it. Side by side, the values of many arms say more:
one that is alike at all of them but one is no chance.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from estimators.diagnosis.result import Shift

_TOLD: Final = 0.3  # of a tolerance; what a recording leaves as open as that says little of an arm


@dataclass(frozen=True)
class ToleratedValue:
    """A value that the simulation states with a tolerance, as one recording has it."""

    name: str  # e.g. "f_v of joint 5 (viscous friction)"
    value: float  # [unit]
    unit: str
    tolerance: float  # standard deviation that the simulation allows [unit]

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON."""
        return asdict(self)

    @classmethod
    def from_json(cls, kept: Mapping[str, Any]) -> ToleratedValue:
        """Return what `as_json` wrote.

        Raises:
            KeyError: Something is not there.
            TypeError: It is none.
            ValueError: A number is none.
        """
        return cls(
            str(kept["name"]), float(kept["value"]), str(kept["unit"]), float(kept["tolerance"])
        )


def tolerated_values(shifts: Iterable[Shift]) -> tuple[ToleratedValue, ...]:
    """Return the values that a recording tells well, of all that its fit may move.

    Args:
        shifts: Of one diagnosis.
    """
    return tuple(
        ToleratedValue(s.name, s.fitted, s.unit, abs((s.fitted - s.nominal) / s.sigmas))
        for s in shifts
        if s.left < _TOLD and s.sigmas != 0.0
    )
