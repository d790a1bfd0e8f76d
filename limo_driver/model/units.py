"""Units of joints: in m and N where they slide, in rad and N m where they turn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

_OF_SLIDES: Final = (("(N m)", "N"), ("N m", "N"), ("rad", "m"), ("kg m^2", "kg"), ("1/rev", "1/m"))


def unit_of(unit: str, sliding: Sequence[bool], joint: int | None = None) -> str:
    """Return the unit at a joint, or of all joints together, such as `N m, N`.

    Args:
        unit: What it is where joints turn, such as `N m s/rad`.
        sliding: Which joints slide, (n,); empty if none does.
        joint: 0-based; all if not given.
    """
    kinds = sliding if joint is None else sliding[joint : joint + 1]
    return ", ".join(dict.fromkeys(_slides(unit) if each else unit for each in kinds)) or unit


def _slides(unit: str) -> str:
    for turning, sliding in _OF_SLIDES:
        unit = unit.replace(turning, sliding)
    return unit
