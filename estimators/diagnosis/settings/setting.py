"""Setting: a chosen constant with unit, trade-off and reason."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

BY_JUDGEMENT: Final = "by judgement"  # nobody measured another value, or nothing of it was kept


@dataclass(frozen=True)
class ChosenNumber:
    """Documentation of a setting."""

    name: str
    value: Any
    unit: str
    meaning: str
    trades: str
    chosen: str


def setting(
    value: Any,  # noqa: ANN401  # a number, or several
    unit: str,
    meaning: str,
    trades: str,
    *,
    chosen: str = BY_JUDGEMENT,
) -> Any:  # noqa: ANN401  # a dataclass field, whose type is the annotation's
    """Declare a setting as a dataclass field.

    Args:
        value: Its value.
        unit: Its unit, in full where it is no SI unit; empty for a count.
        meaning: What it is, in a few words.
        trades: What a larger and a smaller one would do.
        chosen: How it was chosen.
    """
    known = {"unit": unit, "meaning": meaning, "trades": trades, "chosen": chosen}
    return field(default=value, metadata=known)


def settings_of(group: Any) -> Iterator[ChosenNumber]:  # noqa: ANN401  # a dataclass of settings
    """Yield the settings of a group, in order."""
    for item in fields(group):
        yield ChosenNumber(item.name, getattr(group, item.name), **item.metadata)
