"""Settings: every number of the diagnosis that somebody chose, by stage, in one place.

They are constants: nothing changes them while a program runs. `docs/diagnosis_settings.md` lists
them; whoever changes one writes it anew:

    python tests/estimators/diagnosis/test_chosen_numbers.py
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final, TypeVar, dataclass_transform

_Group = TypeVar("_Group")
LEVEL: Final = 0.95  # of intervals, and of what is believed
TAIL: Final = (1 - LEVEL) / 2  # beyond either end of an interval
Z95: Final = 1.96  # deviations of a normal distribution, on either side, that hold 95 %
MAD: Final = 1.4826  # of a normal distribution, its deviation over the median of absolute values
TINY: Final = 1e-12  # in the unit of each, that nothing is divided by less than
ROUNDING: Final = 1e-9  # relative, and in the unit of what is not to be nothing
DEPENDENT: Final = 1e-6  # of the largest, below which columns are but rounding
FINE: Final = 1e-3  # relative, of steps of derivatives, and of changes with which iterations end
LITTLE: Final = 0.05  # of a whole, that hardly matters
MATTERS: Final = 0.1  # of a whole, from which on it matters
HALF: Final = 0.5  # of a whole, more than which is the greater part
SOME: Final = 0.25  # of a whole, that is some of it
MOST: Final = 0.75  # of a whole, that is most of it
NEARLY_ALL: Final = 0.9  # of a whole, that is nearly all of it
FEW: Final = 3  # of anything; what fewer of them have in common is chance
CLEARLY: Final = 1.5  # times another, that something is clearly more
FAR: Final = 3.0  # times another, that something is far more
OUTLYING: Final = 5.0  # usual errors, beyond which one is of another kind
BY_JUDGEMENT: Final = "by judgement"  # nobody measured another value, or nothing of it was kept


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


@dataclass_transform(frozen_default=True, field_specifiers=(setting,))
def settings(group: type[_Group]) -> _Group:
    """Declare a group of settings: the one instance of a frozen dataclass, under its name."""
    return dataclass(frozen=True)(group)()
