"""Inertia of drives that a description adds to its links."""

# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from limo_driver.model.descriptions.description import JointDynamics

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pinocchio as pin

    from limo_driver.model.descriptions.description import RobotDescription
    from limo_driver.model.descriptions.inertial import Inertial

_ROUNDING = 1e-9  # of a moment of inertia, which a rod has alike about two axes
_MOST_OF_OTHERS = 2.0  # times the sum of the others, that a principal moment is still a rounding


def is_nearly_possible(body: Inertial) -> bool:
    """Say whether principal moments are those of a body, but for rounding."""
    smallest, middle, largest = np.linalg.eigvalsh(body.tensor()).tolist()
    return smallest > 0.0 and largest <= _MOST_OF_OTHERS * (smallest + middle)


def with_drives_apart(
    description: RobotDescription,
    tree: pin.Model,
    inertials: dict[str, Inertial],
    joints: Sequence[str],
) -> tuple[dict[str, Inertial], tuple[str, ...]]:
    """Take the inertia of drives out of links that no body has, and state it for their joints.

    Behind a gear, a rotor counts with the square of the ratio, and about the axis of its joint
    alone. Some makers add that to the link: more about this axis than about both others together,
    which the mass of no link brings. Taken for a body it would be felt about those, too.

    Args:
        description: Of the arm; gets the armatures.
        tree: Of its links, each with a joint of its own.
        inertials: Of those links, by name.
        joints: That move them, by link.

    Returns:
        Those links that change, and what to say of them.
    """
    changed: dict[str, Inertial] = {}
    told: list[str] = []
    for index, ((link, body), joint) in enumerate(zip(inertials.items(), joints, strict=True)):
        if is_nearly_possible(body) or body.mass <= 0:
            continue
        axis = np.array(tree.joints[index + 1].createData().S).ravel()[3:]
        tensor = body.tensor()
        about = float(axis @ tensor @ axis)
        surplus = 2.0 * about - float(np.trace(tensor))
        if surplus <= _ROUNDING * about:
            continue
        left = tensor - surplus * np.outer(axis, axis)
        xx, xy, xz, yy, yz, zz = left[np.triu_indices(3)].tolist()
        found = replace(body, inertia=(xx, xy, xz, yy, yz, zz))
        if not is_nearly_possible(found):
            continue
        stated = description.dynamics.get(joint, JointDynamics())
        description.dynamics[joint] = replace(stated, armature=stated.armature + surplus)
        changed[link] = found
        told.append(
            f"link {link} has {about:.3g} kg m² about the axis of joint {joint}, more than its "
            f"mass brings: {surplus:.3g} kg m² are taken as the inertia of the drive (armature)"
        )
    return changed, tuple(told)
