"""Doubts about a description that loads: meshes that are not there, ends of joints in degrees."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.model.descriptions.description import RobotDescription
    from limo_driver.types import FloatArray

_SCHEMES: Final = ("package://", "model://")
_TURNS: Final = 10.0  # [rev], beyond which the end of a joint is one of an angle in degrees
_DEGREES: Final = 720.0  # beyond which it is none, but stands for no end at all


def doubts_about_description(
    description: RobotDescription,
    joints: Sequence[str],
    low: FloatArray,
    high: FloatArray,
    sliding: Sequence[bool],
) -> Iterator[str]:
    """Yield what should be looked at in a description, a line each.

    Args:
        description: As read.
        joints: Names of the joints that move, (n,).
        low: Where their ranges begin, (n,) [rad, m].
        high: Where those end, (n,) [rad, m].
        sliding: Which of them slide, (n,).
    """
    furthest = np.maximum(np.abs(low), np.abs(high))
    odd = [
        name
        for name, end, slides in zip(joints, furthest.tolist(), sliding, strict=True)
        if not slides and _TURNS * 2 * np.pi < end <= _DEGREES
    ]
    if odd:
        largest = float(furthest[[list(joints).index(name) for name in odd]].max())
        yield (
            f"the limits of {shortened(odd)} reach {largest:g} rad, {largest / (2 * np.pi):.0f} "
            "turns: are they in degrees?"
        )
    if lost := lost_meshes(description):
        yield f"{lost}; without them, motion is planned only with `self_collision` switched off"


def lost_meshes(description: RobotDescription) -> str:
    """Say which meshes of collision shapes are not there; nothing where none lacks."""
    lost = list(dict.fromkeys(_lost_meshes(description)))
    if not lost:
        return ""
    return f"not there: collision mesh{'es' * (len(lost) > 1)} {shortened(lost, 3)}"


def _lost_meshes(description: RobotDescription) -> Iterator[str]:
    """Yield meshes of collision shapes that are not there."""
    above = description.path.resolve().parents
    for mesh in description.root.findall("link/collision/geometry/mesh"):
        name = str(mesh.get("filename"))
        if name.startswith("file://"):
            found = Path(name.removeprefix("file://")).is_file()
        else:
            place = name
            for scheme in _SCHEMES:
                place = place.removeprefix(scheme)
            found = Path(place).is_file() or any(
                (folder / place.lstrip("/")).is_file() for folder in above
            )
        if not found:
            yield name
