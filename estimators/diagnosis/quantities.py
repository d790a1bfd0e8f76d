"""Quantities: numbers with units and intervals, joints and lists, in words."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, cast

from limo_driver.runtime.display import joint_called

if TYPE_CHECKING:
    from collections.abc import Sequence

    from estimators.diagnosis.verdict import Interval

UNNUMBERED: Final = frozenset({"text", "joint"})  # units of what is no quantity
_SMALLEST: Final = 1e-12  # half width of an interval below which it has none


def quantity(known: Interval) -> str:
    """Return a number with its unit and interval, to the digits that the interval leaves."""
    value = float(known.value)  # pyright: ignore[reportArgumentType]  # a number, see `_main`
    unit = unit_of(known.unit)
    if known.ci95 is None or None in known.ci95 or known.ci95[0] == known.ci95[1]:
        return f"{value:.3g}{unit}"
    shown, low, high = to_interval(value, *map(float, known.ci95))
    return f"{shown}{unit} [{low}, {high}]"


def to_interval(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return a value and the ends of its interval, to two digits of half that interval."""
    decimals = decimals_of((high - low) / 2)
    shown = [f"{each:.{decimals}f}" for each in (value, low, high)]
    return shown[0], shown[1], shown[2]


def give_or_take(known: Interval) -> str:
    """Return a number with half of its 95 % interval, to the digits that the interval leaves.

    Args:
        known: A number with an interval.
    """
    low, high = cast("tuple[float, float]", known.ci95)
    half = (high - low) / 2
    decimals = decimals_of(half)
    return f"{known.value:.{decimals}f} ± {half:.{decimals}f}"


def several(known: Interval) -> str:
    """Return the numbers of a parameter that has more than one."""
    return _nested(known.value)


def decimals_of(half: float) -> int:
    """Return the decimals that show half of an interval to two digits."""
    return min(max(0, 1 - math.floor(math.log10(max(half, _SMALLEST)))), 9)


def _nested(values: object) -> str:
    if isinstance(values, (tuple, list)):
        return f"({', '.join(map(_nested, values))})"
    return f"{values:.3g}" if isinstance(values, float) else str(values)


def unit_of(unit: str) -> str:
    """Return a unit as it follows a number; nothing where there is none."""
    return f" {unit}" if unit not in {"", "1", *UNNUMBERED} else ""


def of_joints(joints: Sequence[int], names: Sequence[str] = ()) -> str:
    """Return which joints (1-based), in words; none are the whole arm.

    Args:
        joints: Their numbers.
        names: Of all joints of the arm, where they are known.
    """
    if not joints:
        return "whole arm"
    called = [joint_called(j, names[j - 1] if j <= len(names) else "") for j in joints]
    return f"joint{'s' * (len(joints) > 1)} {', '.join(called)}"


def heading_of(joint: int, names: Sequence[str]) -> str:
    """Return how a heading calls a joint (1-based): "Joint 3 (elbow)".

    Args:
        joint: Its number.
        names: Of all joints of the arm.
    """
    text = of_joints((joint,), names)
    return f"{text[:1].upper()}{text[1:]}"


def listed(texts: Sequence[str]) -> str:
    """Join phrases by commas, the last one by "and"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def rounded(error: float, digits: int = 4) -> str:
    """Return an error to a few digits, whatever the arm's scale: 2022, 65.21, 0.003392."""
    decimals = digits - 1 - math.floor(math.log10(error)) if error > 0 else digits - 1
    return f"{error:.{max(0, decimals)}f}"


def of_several(joints: Sequence[int], names: Sequence[str]) -> str:
    """Return joints in few words: "joints 1 to 4", "all joints", "joint 3 (elbow)".

    Args:
        joints: Their numbers, 1-based.
        names: Of all joints of the arm; empty where they are not known.
    """
    known, n = sorted({*joints}), len(names)
    if not known or (known == list(range(1, n + 1)) and n > 1):
        return "all joints"
    if len(known) > 2 and known[-1] - known[0] == len(known) - 1:  # noqa: PLR2004  # a range
        return f"joints {known[0]} to {known[-1]}"
    return of_joints(known, names)


def once(texts: Sequence[str]) -> Sequence[str]:
    """Return texts, and one alone where all are the same."""
    return texts[:1] if len(set(texts)) == 1 else texts
