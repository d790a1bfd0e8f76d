"""Geoms as shapes of a URDF."""

# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np

from limo_driver.model.descriptions.geometry import numbers

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


def shape_of(model: Any, geom: int) -> ET.Element | None:  # noqa: ANN401
    """Return a geom as a shape of a URDF, a mesh as the box around it; None of a plane and such."""
    kind, size = int(model.geom_type[geom]), np.array(model.geom_size[geom])
    kinds = mujoco.mjtGeom
    if kind == int(kinds.mjGEOM_SPHERE):
        return ET.Element("sphere", radius=repr(float(size[0])))
    if kind == int(kinds.mjGEOM_CAPSULE):  # as a cylinder that is rounded off at its ends
        length = repr(float(2 * (size[1] + size[0])))
        return ET.Element("cylinder", radius=repr(float(size[0])), length=length)
    if kind == int(kinds.mjGEOM_CYLINDER):
        return ET.Element("cylinder", radius=repr(float(size[0])), length=repr(float(2 * size[1])))
    if kind == int(kinds.mjGEOM_BOX):
        return ET.Element("box", size=numbers(2 * size))
    if kind in {int(kinds.mjGEOM_MESH), int(kinds.mjGEOM_ELLIPSOID)}:
        return ET.Element("box", size=numbers(2 * np.array(model.geom_aabb[geom][3:])))
    return None


def vertices(model: Any, geom: int) -> FloatArray:  # noqa: ANN401
    """Return the vertices of a mesh in the frame of its geom, (K, 3) [m]."""
    mesh = int(model.geom_dataid[geom])
    first, many = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    return np.array(model.mesh_vert[first : first + many], dtype=np.float64)
