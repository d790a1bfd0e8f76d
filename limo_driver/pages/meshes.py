"""Meshes of a robot's links as pages draw them: few triangles, in the frames of the joints."""

# pinocchio has no stubs and is found through an import hook; this file is an adapter to it.
# pyright: reportMissingImports=false

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pinocchio as pin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

TRIANGLES: Final = 16_000  # of all links: more make a page large, and cannot be seen
_COARSER: Final = 1.25  # by which the grid of vertices grows until that holds
_FINEST: Final = 0.002  # [m], edge of that grid


@dataclass(frozen=True)
class LinkMesh:
    """Triangles fixed to a joint's frame."""

    joint: int  # 0-based; -1 is the fixed base
    vertices: FloatArray  # (V, 3) [m]
    faces: NDArray[np.int64]  # (F, 3)


def meshes_of(model: RobotModel) -> tuple[LinkMesh, ...]:
    """Return the visual meshes of a robot, thinned; none where it has none that can be read."""
    folders = [str(folder) for folder in model.urdf.resolve().parents]
    try:
        geometry = pin.buildGeomFromUrdfString(
            model.pin_model, model.description.text, pin.GeometryType.VISUAL, package_dirs=folders
        )
    except ValueError:  # a mesh that is missing: a page has capsules instead
        return ()
    meshes = [mesh for item in geometry.geometryObjects if (mesh := _mesh(item)) is not None]
    edge = _FINEST
    thinned = meshes
    while sum(len(mesh.faces) for mesh in thinned) > TRIANGLES:
        thinned = [clustered(mesh, edge) for mesh in meshes]
        edge *= _COARSER
    return tuple(mesh for mesh in thinned if len(mesh.faces))


def clustered(mesh: LinkMesh, edge: float) -> LinkMesh:
    """Join the vertices of each cell of a grid, and drop the triangles that vanish.

    Args:
        mesh: What to thin.
        edge: Of a cell [m].

    Source: J. Rossignac and P. Borrel, "Multi-resolution 3D approximations for rendering complex
    scenes", 1993.
    """
    cells = np.floor(mesh.vertices / edge).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.ravel()
    count = np.bincount(cell).astype(float)
    sums = [np.bincount(cell, column) / count for column in mesh.vertices.T]
    faces = cell[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return LinkMesh(mesh.joint, np.stack(sums, axis=1), np.unique(faces, axis=0))


def _mesh(item: Any) -> LinkMesh | None:  # noqa: ANN401  # pinocchio has no types
    shape = item.geometry
    if not hasattr(shape, "tri_indices"):
        return None
    vertices = np.array(shape.vertices()) @ item.placement.rotation.T + item.placement.translation
    triangles = [shape.tri_indices(k) for k in range(shape.num_tris)]
    faces = np.array([[t[0], t[1], t[2]] for t in triangles], dtype=np.int64).reshape(-1, 3)
    return LinkMesh(int(item.parentJoint) - 1, vertices, faces)
