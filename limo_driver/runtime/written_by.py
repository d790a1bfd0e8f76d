"""Which limo wrote a file: it says so, and a refusal names the version that can read it."""

from __future__ import annotations

import re
from importlib.metadata import version
from typing import Final, cast

KEY: Final = "limo"  # of the entry with the version
_NUMBERS: Final = re.compile(r"\d{1,6}(\.\d{1,6}){1,3}")


def installed() -> str:
    """Return the version of this limo."""
    return version("limo")


def writer_of(content: object) -> object:
    """Return the version that the content of a file names, None if it names none."""
    if not isinstance(content, dict):
        return None
    named = cast("dict[object, object]", content)
    packages = named.get("packages")  # of a model folder
    if isinstance(packages, dict):
        named = cast("dict[object, object]", packages)
    return named.get(KEY, named.get("code"))  # of a stored version


def advice_to_update(written: object) -> str:
    """Return what a refusal of a file adds where a newer limo wrote it.

    Args:
        written: Version that the file names, if it does.

    Returns:
        `"; limo 0.4.0 wrote it, ..."`, or `""` unless that is a version above this one.
    """
    own = installed()
    if not isinstance(written, str) or _ordered(written) <= _ordered(own):
        return ""
    return f"; limo {written} wrote it and can read it, this is {own}"


def _ordered(text: str) -> tuple[int, ...]:
    found = _NUMBERS.match(text)
    return tuple(int(part) for part in found[0].split(".")) if found else ()
