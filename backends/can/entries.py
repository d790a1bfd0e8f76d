"""Entries of a section of `arm.yaml`: what may be written, within which bounds."""

from __future__ import annotations

import math
from dataclasses import field, fields
from typing import Any, Final

from limo_driver.errors import ConfigError

REQUIRED: Final = object()
TEXT, FLAG, WHOLE, REAL = "text", "flag", "whole", "real"


def entry(
    kind: str,
    default: Any = REQUIRED,  # noqa: ANN401  # of the field's own type
    *,
    lower: float = -math.inf,
    upper: float = math.inf,
    of: tuple[Any, ...] = (),
    above: bool = False,
) -> Any:  # noqa: ANN401  # a dataclass field
    """Declare an entry.

    Args:
        kind: `TEXT`, `FLAG`, `WHOLE` or `REAL`.
        default: Where it is not given; without one, it has to be.
        lower: Lowest value.
        upper: Highest value.
        of: The values there are, where they can be counted.
        above: Whether `lower` itself is too low.
    """
    metadata = {"kind": kind, "lower": lower, "upper": upper, "of": of, "above": above}
    if default is REQUIRED:
        return field(metadata=metadata)
    return field(default=default, metadata=metadata)


class Section:
    """A frozen dataclass of entries, checked when it is made.

    Raises:
        ConfigError: Names the entry, what was given and what is possible.
    """

    def __post_init__(self) -> None:
        for item in fields(self):  # type: ignore[arg-type]  # each subclass is a dataclass
            value = getattr(self, item.name)
            if not item.metadata or value is None:
                continue
            check(item.name, value, **item.metadata)


def check(
    name: str,
    value: Any,  # noqa: ANN401  # of any kind
    kind: str,
    lower: float,
    upper: float,
    of: tuple[Any, ...],
    *,
    above: bool,
) -> None:
    """Refuse a value that an entry cannot have."""
    if of:
        if value not in of:
            known = ", ".join(str(item) for item in of)
            raise ConfigError(f"{name} is {value}, expected one of {known}")
        return
    if kind == TEXT:
        if not value:
            raise ConfigError(f"{name} is empty")
        return
    if kind == FLAG:
        return
    if isinstance(value, bool) or not isinstance(value, int if kind == WHOLE else (int, float)):
        expected = "a whole number" if kind == WHOLE else "a number"
        raise ConfigError(f"{name} is {value!r}, expected {expected}")
    if not lower <= value <= upper or (above and value == lower):
        bounds = _bounds(lower, upper, above=above)
        raise ConfigError(f"{name} is {value:g}, expected {bounds}")


def _bounds(lower: float, upper: float, *, above: bool) -> str:
    least = f"{'above' if above else 'at least'} {lower:g}"
    return least if math.isinf(upper) else f"{least} and at most {upper:g}"
