"""Wording: signatures of effects, and names of recordings, as phrases for a report."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

from estimators.diagnosis.settings.afterwards import WORDING
from limo_driver.physics import BodyEffect, spoken
from limo_driver.physics.catalogue import description_of, known_as

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording

LINK_INERTIA = "link_inertia"  # what a body of the simulation has wrong; no effect of its own
_OTHERWISE = {
    LINK_INERTIA: "several joints err together, smoothly with the pose and without history",
}


def signature_of(effect: str) -> str:
    """Say how an effect shows; completes "At joint 3 …"."""
    said = _OTHERWISE.get(effect) or description_of(effect).signature
    return said or f"the error is what {spoken(effect)} makes"


def is_of_bodies(effect: str) -> bool:
    """Say whether an effect is of a body, and so felt by all joints below it."""
    known = known_as(effect)
    return effect == LINK_INERTIA or (known is not None and issubclass(known, BodyEffect))


def names_of(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the file names of recordings, and numbers for those that have none of their own."""
    files = [PurePath(recording.source).name for recording in recordings]
    return tuple(
        name if name and files.count(name) == 1 else f"recording {k}"
        for k, name in enumerate(files, start=1)
    )


def of_joints(joints: Sequence[int]) -> str:
    """Return which joints (1-based), in words; none are the whole arm."""
    if not joints:
        return "whole arm"
    return f"joint{'s' * (len(joints) > 1)} {', '.join(map(str, joints))}"


def listed(texts: Sequence[str]) -> str:
    """Join phrases by commas, the last one by "and"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def likelier(lead: float) -> str:
    """Say evidence [nat] as odds; completes "the recordings are …"."""
    if lead > math.log(WORDING.beyond_doubt):
        return "beyond doubt likelier"
    odds = math.exp(lead)
    digits = max(0, math.floor(math.log10(odds)) - 1)
    return f"{round(odds, -digits):,.0f} times likelier".replace(",", "\N{NO-BREAK SPACE}")


def rounded(error: float, digits: int = 4) -> str:
    """Return an error to a few digits, whatever the arm's scale: 2022, 65.21, 0.003392."""
    decimals = digits - 1 - math.floor(math.log10(error)) if error > 0 else digits - 1
    return f"{error:.{max(0, decimals)}f}"


def of_several(joints: Sequence[int], n: int) -> str:
    """Return joints (1-based) of an arm of n in few words: "joints 1 to 4", "all joints"."""
    known = sorted({*joints})
    if not known or (known == list(range(1, n + 1)) and n > 1):
        return "all joints"
    if len(known) > 2 and known[-1] - known[0] == len(known) - 1:  # noqa: PLR2004  # a range
        return f"joints {known[0]} to {known[-1]}"
    return of_joints(known)
