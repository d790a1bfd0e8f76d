"""Units of what joints that slide have, where those of joints that turn are known."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

_OF_SLIDES: Final = {
    "rad": "m",
    "rad/s": "m/s",
    "rad/s^2": "m/s^2",
    "N m": "N",
    "N m/rad": "N/m",
    "N m s/rad": "N s/m",
    "kg m^2": "kg",
    "rad/(N m)": "m/N",
}


def unit_of(unit: str, *, is_sliding: bool) -> str:
    """Return the unit of a joint that slides, of what has this unit where a joint turns."""
    return _OF_SLIDES.get(unit, unit) if is_sliding else unit


def common_unit(unit: str, sliding: Iterable[bool]) -> str:
    """Return the units that joints have together, such as `N m` or, of some that slide, `N m, N`.

    Args:
        unit: Of a joint that turns.
        sliding: Which joints slide, (n,).
    """
    return ", ".join(dict.fromkeys(unit_of(unit, is_sliding=each) for each in sliding))
