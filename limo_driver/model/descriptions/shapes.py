"""Collision shapes of an arm: convex each, with a capsule around it and exact distances."""

# pinocchio and coal have no stubs; this file is the adapter to their shapes.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from xml.etree import ElementTree as ET

import coal
import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError
from limo_driver.runtime.display import shortened
from limo_driver.types import BoolArray, FloatArray, IntArray, readonly

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from limo_driver.model.descriptions.description import RobotDescription

_HULL: Final = "Qt"  # what qhull is asked for: triangles
_TOLERANCE: Final = 1e-10  # [m] of a distance, so that its differences give a derivative
_WIDER: Final = np.linspace(1.0, 1.6, 13)  # radii that are tried, in the least there can be
_ROUNDS: Final = 100  # of moving the centre towards the farthest corner
_SCHEMES: Final = ("package://", "model://")
_TURNS: Final = 10.0  # [rev], beyond which the end of a joint is one of an angle in degrees
_DEGREES: Final = 720.0  # beyond which it is none, but stands for no end at all


@dataclass(frozen=True)
class Capsule:
    """A collision capsule fixed to a link: all points within `radius` of a segment."""

    link: str
    joint: int  # 0-based joint that moves it; -1 is the fixed base
    start: FloatArray  # (3,) [m], in the frame of that joint
    end: FloatArray  # (3,) [m]
    radius: float  # [m]


@dataclass(frozen=True)
class ArmShapes:
    """The collision shapes of an arm; of a mesh, its convex hull."""

    model: pin.Model
    geometry: pin.GeometryModel
    capsules: tuple[Capsule, ...]  # each shape, or the smallest that was found around it
    round: BoolArray  # whether the capsule is the shape itself


class ShapeDistances:
    """Exact distances between pairs of an arm's shapes, and of shapes from the plane z = 0.

    Args:
        shapes: Of the arm.
        pairs: Indices of shapes, (c, 2).
    """

    def __init__(self, shapes: ArmShapes, pairs: IntArray) -> None:
        self._model, self._data = shapes.model, shapes.model.createData()
        many = len(shapes.capsules)
        self._geometry = shapes.geometry.copy()
        self._geometry.removeAllCollisionPairs()
        plane = coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
        self._geometry.addGeometryObject(pin.GeometryObject("plane", 0, pin.SE3.Identity(), plane))
        for i, k in pairs.tolist():
            self._geometry.addCollisionPair(pin.CollisionPair(i, k))
        for i in range(many):
            self._geometry.addCollisionPair(pin.CollisionPair(i, many))
        self._found = self._geometry.createData()
        for request in self._found.distanceRequests:
            request.gjk_tolerance = request.epa_tolerance = _TOLERANCE
        angular = ~shapes.round
        self._angular = np.concatenate([angular[pairs].any(axis=1), angular])

    def sharpen(
        self,
        position: FloatArray,
        gap: FloatArray,
        lowest: FloatArray,
        near: float,
        low: FloatArray,
        *,
        all_of: bool = True,
    ) -> None:
        """Replace the distances of capsules by those of the shapes in them, where it matters.

        Args:
            position: (T, n).
            gap: Between the capsules of each pair, (T, c) [m]; written to.
            lowest: Height of each capsule, (T, m) [m]; written to.
            near: Gap from which on that of the capsules is enough [m].
            low: Height from which on that of the capsules is enough, (m,) [m].
            all_of: False: once one is too small, the others of that position become infinite.
        """
        limits = np.concatenate([np.full(gap.shape[1], near), low])
        below = np.concatenate([gap, lowest], axis=1)
        close = (below < limits) & self._angular
        for t in np.flatnonzero(close.any(axis=1)).tolist():
            if not all_of and (below[t] < limits)[~self._angular].any():
                below[t, close[t]] = np.inf
                continue
            pin.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._found, position[t]
            )
            asked = np.flatnonzero(close[t])
            worst_first = asked[np.argsort((below[t] - limits)[asked], kind="stable")].tolist()
            for done, k in enumerate(worst_first, 1):
                found = pin.computeDistance(self._geometry, self._found, k).min_distance
                below[t, k] = max(below[t, k], found)
                if not all_of and below[t, k] < limits[k]:
                    below[t, worst_first[done:]] = np.inf
                    break
        gap[:], lowest[:] = np.split(below, [gap.shape[1]], axis=1)


def read_shapes(description: RobotDescription, model: pin.Model) -> ArmShapes:
    """Read the collision shapes of an arm.

    Args:
        description: As read.
        model: Of its joints.

    Raises:
        ConfigError: A mesh that the description names is not there.
    """
    try:
        geometry = pin.buildGeomFromUrdfString(
            model,
            ET.tostring(description.without("visual", "material"), encoding="unicode"),
            pin.GeometryType.COLLISION,
            package_dirs=[str(folder) for folder in description.path.resolve().parents],
        )
    except ValueError as error:
        reason = lost_meshes(description) or " ".join(str(error).split())
        raise ConfigError(
            f"its collision shapes cannot be read: {reason}", path=description.path
        ) from None
    for item in geometry.geometryObjects:
        item.geometry = _convex(item.geometry, description.hulls.get(item.name))
    items = list(geometry.geometryObjects)
    return ArmShapes(
        model,
        geometry,
        tuple(_capsule(model, item) for item in items),
        np.array([_is_round(item.geometry) for item in items], dtype=bool),
    )


def _convex(shape: Any, corners: FloatArray | None) -> Any:  # noqa: ANN401  # coal has no types
    """Return the hull of a mesh, or of the corners that a shape stands for; others as they are."""
    if corners is None and not hasattr(shape, "vertices"):
        return shape
    points = np.array(shape.vertices()) if corners is None else corners
    several = coal.StdVec_Vec3s()
    for point in np.unique(points, axis=0):
        several.append(point)
    return coal.ConvexBase.convexHull(several, True, _HULL)


def _is_round(shape: Any) -> bool:  # noqa: ANN401
    return isinstance(shape, (coal.Capsule, coal.Sphere))


def _capsule(model: pin.Model, item: pin.GeometryObject) -> Capsule:
    shape, placement = item.geometry, item.placement
    if isinstance(shape, (coal.Capsule, coal.Cylinder)):
        axis = np.array([0.0, 0.0, float(shape.halfLength)])
        start, end, radius = -axis, axis, float(shape.radius)
    elif isinstance(shape, coal.Sphere):
        start, end, radius = np.zeros(3), np.zeros(3), float(shape.radius)
    else:
        start, end, radius = enclosing_capsule(corners_of(shape))
    return Capsule(
        link=str(model.frames[item.parentFrame].name),
        joint=int(item.parentJoint) - 1,
        start=readonly(placement.act(start)),
        end=readonly(placement.act(end)),
        radius=radius,
    )


def corners_of(shape: Any) -> FloatArray:  # noqa: ANN401
    """Return the corners of a hull or of the box around any other shape, (K, 3) [m]."""
    if isinstance(shape, coal.Convex):
        return np.array(shape.points())
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    return box_corners(high - low) + (low + high) / 2


class Enclosing(NamedTuple):
    """All points within a radius of a segment."""

    start: FloatArray  # (3,) [m]
    end: FloatArray  # (3,) [m]
    radius: float  # [m]


def enclosing_capsule(points: FloatArray) -> Enclosing:
    """Return a capsule around points, the smallest of several axes and radii.

    A thicker capsule may be shorter, since its ends are round.

    Args:
        points: (K, 3) [m].
    """
    middle = points.mean(axis=0)
    _, _, own = np.linalg.svd(points - middle, full_matrices=False)
    best, least = None, np.inf
    for axis in (*np.eye(3), *own):
        for found in _along(points - middle, axis):
            length = float(np.linalg.norm(found.end - found.start))
            volume = np.pi * found.radius**2 * (length + 4 / 3 * found.radius)
            if volume < least:
                best, least = found, volume
    assert best is not None  # noqa: S101  # there are axes
    return Enclosing(middle + best.start, middle + best.end, best.radius)


def box_corners(size: FloatArray) -> FloatArray:
    """Return the corners of a box around the origin, (8, 3) [m].

    Args:
        size: Whole lengths of its sides, (3,) [m].
    """
    return np.array(list(product((-0.5, 0.5), repeat=3))) * size


def _along(points: FloatArray, axis: FloatArray) -> Iterator[Enclosing]:
    """Yield capsules along an axis around points, (K, 3), from the thinnest on."""
    across = np.linalg.svd(axis[None])[2][1:]  # two directions at right angles to it
    flat, along = points @ across.T, points @ axis
    centre = _centre(flat)
    distance = np.linalg.norm(flat - centre, axis=1)
    base = centre @ across
    for radius in (_WIDER * float(distance.max())).tolist():
        reach = np.sqrt(np.maximum(radius**2 - distance**2, 0.0))
        low, high = float((along + reach).min()), float((along - reach).max())
        if low > high:
            low = high = (low + high) / 2
        yield Enclosing(base + low * axis, base + high * axis, radius)


def _centre(flat: FloatArray) -> FloatArray:
    """Return the centre of a circle around points (K, 2) that is nearly the smallest.

    Source: Bădoiu and Clarkson, "Smaller core-sets for balls", SODA 2003.
    """
    centre = flat.mean(axis=0)
    for k in range(1, _ROUNDS):
        farthest = flat[int(np.linalg.norm(flat - centre, axis=1).argmax())]
        centre = centre + (farthest - centre) / (k + 1)
    return centre


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
    for mesh in description.root.findall("link/collision/geometry/mesh"):
        name = str(mesh.get("filename"))
        if mesh_file(description, name) is None:
            yield name


def mesh_file(description: RobotDescription, name: str) -> Path | None:
    """Return the file of a mesh that a description names; None if it is not there.

    Args:
        description: As read; packages are sought in the folders above it.
        name: As it stands there, with or without a scheme.
    """
    if name.startswith("file://"):
        tried = [Path(name.removeprefix("file://"))]
    else:
        place = name
        for scheme in _SCHEMES:
            place = place.removeprefix(scheme)
        above = description.path.resolve().parents
        tried = [Path(place), *(folder / place.lstrip("/") for folder in above)]
    return next((path for path in tried if path.is_file()), None)
