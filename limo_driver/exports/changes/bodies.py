"""Bodies: how the inertia of a link is shared by the bodies of a file that move with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.model.descriptions.inertial import Inertial

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from limo_driver.types import FloatArray

_SEVERAL: Final = 2
SAME: Final = 1e-9  # relative change of a second moment that is none


@dataclass(frozen=True)
class BodyPart:
    """A body of a file that moves rigidly with a link."""

    name: str
    inertial: Inertial | None  # in its own frame; None where it has no mass
    pose: FloatArray  # (4, 4), of its frame in that of the link


def pseudo_inertia(body: Inertial) -> FloatArray:
    """Return the second moments of mass about the origin, (4, 4): linear in all parameters."""
    h = body.mass * np.array(body.com)
    tensor = body.tensor()
    about_com = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    J = np.zeros((4, 4))
    J[:3, :3] = about_com + np.outer(h, h) / body.mass
    J[:3, 3] = J[3, :3] = h
    J[3, 3] = body.mass
    return J


def inertial_of(J: FloatArray) -> Inertial:
    """Return the body that has these second moments of mass."""
    mass = float(J[3, 3])
    com = J[:3, 3] / mass
    about_com = J[:3, :3] - mass * np.outer(com, com)
    tensor = np.trace(about_com) * np.eye(3) - about_com
    x, y, z = com.tolist()
    xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
    return Inertial(mass, (x, y, z), (xx, xy, xz, yy, yz, zz))


def shared(parts: tuple[BodyPart, ...], wanted: Inertial) -> Mapping[str, Inertial]:
    """Return new inertias of the parts of a link that together make the wanted one.

    The link's own body takes all of the change, if it is a possible body then; else the wanted
    inertia is shared by all of them in proportion to their masses. Parts that do not change are
    left out.

    Args:
        parts: The link's own body first.
        wanted: Of all of them together, in the frame of the link.
    """
    J = [np.zeros((4, 4)) if p.inertial is None else moved(p.inertial, p.pose) for p in parts]
    target = pseudo_inertia(wanted)
    change = target - sum(J)
    scale = np.sqrt(np.outer(np.diag(target), np.diag(target)))
    if (np.abs(change) <= SAME * scale).all():
        return {}
    own = _in_frame(J[0] + change, parts[0].pose)
    if own[3, 3] > 0 and (body := inertial_of(own)).is_consistent():
        return {parts[0].name: body}
    masses = np.array([each[3, 3] for each in J])
    shares = masses / masses.sum()
    return {
        part.name: inertial_of(_in_frame(share * target, part.pose))
        for part, share in zip(parts, shares.tolist(), strict=True)
        if share > 0
    }


def rescaled_lines(
    parts: Sequence[BodyPart], changes: Mapping[str, Inertial], wanted: Inertial
) -> list[str]:
    """Say by how much the bodies beside a link's own change, where that one cannot take it all.

    Args:
        parts: As for `shared`.
        changes: What that returned.
        wanted: Of all of them together.
    """
    if len(changes) < _SEVERAL:
        return []
    names = ", ".join(changes)
    weight = sum(part.inertial.mass for part in parts if part.inertial is not None)
    return [
        f"what {names} weigh: {weight:.3g} kg in the file, {wanted.mass:.3g} kg in the "
        "simulation, and all of them change in proportion; to keep them, let the file be the "
        "simulation's robot"
    ]


def moved(body: Inertial, pose: FloatArray) -> FloatArray:
    """Return the second moments of mass of a body in the frame in which its own is at a pose."""
    return pose @ pseudo_inertia(body) @ pose.T


def _in_frame(J: FloatArray, pose: FloatArray) -> FloatArray:
    inverse = np.linalg.inv(pose)
    return inverse @ J @ inverse.T
