"""Joints that follow others: what the file states of them stays, and is part of what was found."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from limo_driver.model.descriptions.description import JointDynamics
from limo_driver.physics.described import REFLECTED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from limo_driver.model import RobotModel

_ROUNDING: Final = 1e-9  # relative


def without(
    found: Sequence[JointDynamics], added: Sequence[JointDynamics], model: RobotModel
) -> tuple[tuple[JointDynamics, ...], tuple[str, ...]]:
    """Return what is left of each joint beside its followers, and a line where that is below 0.

    Args:
        found: Of each joint with all that follows it.
        added: What those that follow it add to it, as the file has them.
        model: The robot as the file has it.
    """
    left, lines = list[JointDynamics](), list[str]()
    for name, whole, more in zip(model.joint_names, found, added, strict=True):
        values: dict[str, float] = {}
        for key in REFLECTED:
            total, other = getattr(whole, key), getattr(more, key)
            if other:
                rest = total - other
                values[key] = rest if abs(rest) > _ROUNDING * total else 0.0
            if values.get(key, 0.0) < 0.0:
                values[key] = 0.0
                lines.append(
                    f"joint {name}: the file's own {key} of what follows it, {other:.3g} as it is "
                    f"felt there, stays; {total:.3g} was found of both together"
                )
        left.append(replace(whole, **values))
    return tuple(left), tuple(lines)
