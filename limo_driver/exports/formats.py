"""Simulations in the files of other simulators: which file each target is an edit of."""

from __future__ import annotations

from typing import Final

MJCF: Final = "mjcf"
URDF: Final = "urdf"
DRAKE: Final = "drake"  # a URDF with the tags of Drake, which knows no dry friction
ISAAC_LAB: Final = "isaaclab"  # a URDF, and actuators in Python beside it
USD: Final = "usd"  # a layer over the user's file, with the attributes of PhysX and of Newton
KINDS: Final = (MJCF, URDF, DRAKE, ISAAC_LAB, USD)

WITH_FRICTION: Final = (MJCF, URDF, ISAAC_LAB, USD)
WITH_ARMATURE: Final = (MJCF, DRAKE, ISAAC_LAB, USD)


def edited_format(kind: str) -> str:
    """Return the format of the file that a target is an edit of, `mjcf`, `urdf` or `usd`."""
    return kind if kind in {MJCF, USD} else URDF
