"""Collision shapes of USD as those of a URDF: simple ones exactly, meshes as boxes with corners."""

# usd-core ships no usable stubs, and is an extra.
# pyright: reportMissingImports=false, reportMissingModuleSource=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.model.descriptions.geometry import numbers, rpy_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from limo_driver.types import FloatArray

# From the axis along which a shape lies to z, along which it lies in a URDF.
_ALONG: Final = {
    "X": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "Y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "Z": np.eye(3),
}
_FEWEST: Final = 4  # corners of a body


def write_shapes(
    link: ET.Element,
    prim: Any,  # noqa: ANN401
    bodies: Mapping[str, Any],
    shift: FloatArray,
) -> dict[str, FloatArray]:
    """Write the collision shapes of a body into its link.

    Args:
        link: To be added to.
        prim: The body.
        bodies: All bodies of the arm by name, whose shapes are not those of their parents.
        shift: From the frame of the body to that of the link, (3,) [m].

    Returns:
        Corners of each mesh in the frame of the box that stands for it, (K, 3) [m], by name of the
        link and number of the shape on it.
    """
    hulls: dict[str, FloatArray] = {}
    for shape, to_body in _shapes_of(prim, {body.GetPath() for body in bodies.values()}):
        found = _simple(shape, to_body)
        if found is None and (corners := _corners(shape, to_body)) is not None:
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
            hulls[f"{link.get('name')}_{len(link.findall('collision'))}"] = corners - middle
            found = ET.Element("box", size=numbers(np.ptp(corners, axis=0))), middle, np.eye(3)
        if found is None:
            continue
        element, place, R = found
        collision = ET.SubElement(link, "collision")
        ET.SubElement(collision, "origin", xyz=numbers(place - shift), rpy=numbers(rpy_of(R)))
        ET.SubElement(collision, "geometry").append(element)
    return hulls


def _shapes_of(prim: Any, bodies: set[Any]) -> Iterator[tuple[Any, FloatArray]]:  # noqa: ANN401
    """Yield the shapes of a body that collide, and (4, 4) from each to the body, of rows."""
    from pxr import Usd, UsdGeom, UsdPhysics

    cache = UsdGeom.XformCache()
    to_body = cache.GetLocalToWorldTransform(prim).RemoveScaleShear().GetInverse()
    walk = iter(Usd.PrimRange(prim, Usd.TraverseInstanceProxies()))
    colliding: list[Any] = []  # paths at or below which shapes collide
    for item in walk:
        path = item.GetPath()
        if path != prim.GetPath() and path in bodies:
            walk.PruneChildren()
            continue
        if item.HasAPI(UsdPhysics.CollisionAPI):
            colliding.append(path)
        if item.IsA(UsdGeom.Gprim) and any(path.HasPrefix(above) for above in colliding):
            yield item, np.array(cache.GetLocalToWorldTransform(item) * to_body, dtype=np.float64)


def _simple(
    shape: Any,  # noqa: ANN401
    to_body: FloatArray,
) -> tuple[ET.Element, FloatArray, FloatArray] | None:
    """Return a shape that a URDF has, its place [m] and rotation; None if it has none such."""
    from pxr import UsdGeom

    A = to_body[:3, :3].T
    scale = np.linalg.norm(A, axis=0)
    mirrored = np.linalg.det(A) < 0  # each of these shapes is its own mirror image
    R = A / scale * np.array([1.0, 1.0, -1.0 if mirrored else 1.0])
    place, largest = to_body[3, :3], float(scale.max())
    if shape.IsA(UsdGeom.Sphere):
        radius = largest * float(UsdGeom.Sphere(shape).GetRadiusAttr().Get())
        return ET.Element("sphere", radius=repr(radius)), place, R
    if shape.IsA(UsdGeom.Cube):
        size = scale * float(UsdGeom.Cube(shape).GetSizeAttr().Get())
        return ET.Element("box", size=numbers(size)), place, R
    for kind in (UsdGeom.Capsule, UsdGeom.Cylinder):
        if shape.IsA(kind):
            own = kind(shape)
            radius = largest * float(own.GetRadiusAttr().Get())
            axis = str(own.GetAxisAttr().Get())
            length = float(own.GetHeightAttr().Get()) * float(scale["XYZ".index(axis)])
            if kind is UsdGeom.Capsule:  # as a cylinder that is rounded off at its ends
                length += 2 * radius
            element = ET.Element("cylinder", radius=repr(radius), length=repr(length))
            return element, place, R @ _ALONG[axis]
    return None


def _corners(shape: Any, to_body: FloatArray) -> FloatArray | None:  # noqa: ANN401
    """Return the corners of a mesh in the frame of its body, (K, 3) [m]; None of what is none."""
    from pxr import UsdGeom

    if not shape.IsA(UsdGeom.Mesh):
        return None
    points = np.array(UsdGeom.Mesh(shape).GetPointsAttr().Get() or (), dtype=np.float64)
    if len(points) < _FEWEST or not np.isfinite(points).all():
        return None
    return points @ to_body[:3, :3] + to_body[3, :3]
