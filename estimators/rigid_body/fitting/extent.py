"""Extent: the sphere in which the mass of a body lies, as far as a description knows.

Ten parameters may be those of a rigid body, and yet have its mass where the arm is not. Of a
density within a sphere of radius r around c,

    ∫ρ (r² - |x - c|²) = m (r² - |c|²) + 2 c·(m c_com) - ½ tr(I) >= 0,

which is linear in the parameters, and bounds the centre of mass and the moments together. Moments
that no body has may hide from it a centre of mass that lies outside, which no mass inside has.

The sphere holds what is known of a link: where its joint is and those that it carries, its
collision shapes, and what the nominal body extends over. All of it is taken generously: covers,
cables and the counterbalance behind a joint are drawn nowhere. A load is fixed to the last link,
and sticks out.

Source: Wensing, Kim and Slotine, "Linear matrix inequalities for physically consistent inertial
parameter identification", RA-L 2018 (density realizability on an ellipsoid).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from estimators.rigid_body.regressor import PER_LINK
from limo_driver.errors import ConfigError
from limo_driver.model import RobotModel
from limo_driver.model.descriptions.geometry import Inertial
from limo_driver.types import FloatArray

_GENEROUS: Final = 2.0  # times the radius of what is known of a link
_DRIVE: Final = 0.1  # of the arm's length, which a link reaches at least: it houses a drive
_LOAD: Final = 0.5  # of the arm's length, by which a load may stick out beyond that
_UNIFORM: Final = 5.0  # squared half axis of a uniform ellipsoid over the variance along it
_HALVINGS: Final = 20  # of the part of a change up to where a body would leave
_ROUNDS: Final = 100  # of moving a centre towards what is farthest


@dataclass(frozen=True)
class Extent:
    """A sphere in which the mass of a body lies, in the frame of its link."""

    centre: FloatArray  # (3,) [m]
    radius: float  # [m]

    @property
    def slope(self) -> FloatArray:
        """Derivative of ∫ρ (r² - |x - c|²) by (m, m c, I at the joint frame), (10,)."""
        slope = np.zeros(PER_LINK)
        slope[0] = self.radius**2 - self.centre @ self.centre
        slope[1:4] = 2.0 * self.centre
        slope[[4, 6, 9]] = -0.5  # Ixx, Iyy, Izz
        return slope

    def holds(self, parameters: FloatArray) -> bool:
        """Say whether all mass of a body (10,) can lie in it."""
        mass, off = parameters[0], parameters[1:4] - parameters[0] * self.centre
        inside = float(np.linalg.norm(off)) <= self.radius * mass
        return bool(inside and self.slope @ parameters >= 0.0)

    def part(self, start: FloatArray, change: FloatArray) -> float:
        """Return how much of a change of a body (10,) that lies in it leaves it there, 0 to 1."""
        if self.holds(start + change):
            return 1.0
        least, most = 0.0, 1.0  # bodies that it holds are a convex set
        for _ in range(_HALVINGS):
            middle = 0.5 * (least + most)
            least, most = (middle, most) if self.holds(start + middle * change) else (least, middle)
        return least


@dataclass(frozen=True)
class Extents:
    """Extents of the links of an arm, each found when it is asked for.

    Args:
        model: The arm with bodies that are believed to be about right.
    """

    model: RobotModel
    _known: dict[int, Extent] = field(default_factory=dict[int, "Extent"], init=False)

    def of(self, link: int) -> Extent:
        """Return that of a link (0-based) and, of the last one, of a load on it."""
        if link not in self._known:
            centre, radius = _around(*zip(*self._places(link), strict=True))
            length = self._length()
            radius = max(_GENEROUS * radius, _DRIVE * length)
            last = link == self.model.linkage.links - 1
            self._known[link] = Extent(centre, radius + last * _LOAD * length)
        return self._known[link]

    def _places(self, link: int) -> Iterator[tuple[FloatArray, float]]:
        """Yield spheres (3,), radius [m] that are known to belong to a link."""
        tree = self.model.pin_tree
        yield np.zeros(3), 0.0
        for joint in range(1, tree.njoints):
            if int(tree.parents[joint]) == link + 1:
                yield np.array(tree.jointPlacements[joint].translation), 0.0
        yield _sphere_of(self.model.inertials[self.model.link_names[link]])
        try:
            capsules = self.model.capsules()
        except ConfigError:
            return  # its meshes are elsewhere, and the rest has to do
        for capsule in capsules:
            if capsule.joint == link:
                yield np.array(capsule.start), capsule.radius
                yield np.array(capsule.end), capsule.radius

    def _length(self) -> float:
        """Return the length of the arm [m]; of a single joint, that of its link is all there is."""
        last = self.model.inertials[self.model.link_names[-1]]
        return self.model.length + float(np.linalg.norm(last.com))


def _sphere_of(body: Inertial) -> tuple[FloatArray, float]:
    """Return the sphere around a uniform ellipsoid that has a body's inertia."""
    tensor = body.tensor()
    moments = np.linalg.eigvalsh(0.5 * np.trace(tensor) * np.eye(3) - tensor)
    variance = max(float(moments[-1]), 0.0) / body.mass if body.mass > 0 else 0.0
    return np.array(body.com), float(np.sqrt(_UNIFORM * variance))


def _around(centres: tuple[FloatArray, ...], radii: tuple[float, ...]) -> tuple[FloatArray, float]:
    """Return centre and radius of a sphere around spheres that is nearly the smallest.

    Source: Bădoiu and Clarkson, "Smaller core-sets for balls", SODA 2003.
    """
    points, own = np.stack(centres), np.array(radii)
    centre = points.mean(axis=0)

    def far(from_: FloatArray) -> FloatArray:
        return np.linalg.norm(points - from_, axis=1) + own

    for k in range(1, _ROUNDS):
        farthest = int(far(centre).argmax())
        centre = centre + (points[farthest] - centre) / (k + 1)
    return centre, float(far(centre).max())
