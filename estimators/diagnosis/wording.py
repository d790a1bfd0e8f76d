"""Wording: signatures of effects, and names of recordings, as phrases for a report."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

from limo_driver.physics import BodyEffect, spoken
from limo_driver.physics.catalogue import description_of, known_as

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.recordings.recording import Recording

_COUNTED, _MOST = 3, 99  # powers of ten: up to where odds are counted, and beyond which nobody does

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


def times(lead: float) -> str:
    """Say evidence [nat] as odds; beyond 10^99 nobody counts."""
    power = lead / math.log(10.0)
    if power < _COUNTED:
        return f"{math.exp(lead):.0f} times"
    return f"more than 10^{_MOST} times" if power > _MOST else f"10^{power:.0f} times"
