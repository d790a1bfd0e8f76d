"""Shorten documented commands where `LIMO_SHORT` is set, so that they can be tried quickly.

Whoever sets it is told of every cut: a result must not pass for that of the command as it stands.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from typing import TypeVar

    _Number = TypeVar("_Number", int, float)

VARIABLE: Final = "LIMO_SHORT"


def shortened(option: str, given: _Number | None, most: _Number) -> _Number | None:
    """Return what was given for an option, or less where `LIMO_SHORT` is set.

    Args:
        option: Such as --duration.
        given: None for no end.
        most: Where the variable is set.
    """
    if not os.environ.get(VARIABLE) or (given is not None and given <= most):
        return given
    instead = "no end" if given is None else f"{given:g}"
    sys.stderr.write(f"limo: {VARIABLE} is set: {option} {most:g} instead of {instead}\n")
    return most
