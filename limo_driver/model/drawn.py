"""How an arm looks: triangles and colours of its links, as its file draws them, thinned for a page.

Of a URDF the visual shapes, of an MJCF the geoms that MuJoCo's viewer shows. Where a mesh is not
there, and where a file draws nothing, collision shapes stand for it.
"""

# pinocchio, coal and MuJoCo have no stubs; this file is the adapter to what they draw.
# pyright: reportMissingImports=false, reportUnknownParameterType=false, reportAttributeAccessIssue=false
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.geometry import Colour, Surface, read_mesh, rotation_of
from limo_driver.model.descriptions.shapes import Capsule, corners_of, mesh_file

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from xml.etree import ElementTree as ET

    from limo_driver.model.descriptions.description import RobotDescription
    from limo_driver.model.robot_model import RobotModel
    from limo_driver.types import FloatArray, IntArray

TRIANGLES: Final = 60_000  # of all links: more make a page large, and cannot be seen
_COARSER: Final = 1.25  # by which the grid of vertices grows until that holds
_FINEST: Final = 0.0005  # [m], edge of that grid
_AROUND: Final = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
_ARC: Final = np.linspace(-np.pi / 2, np.pi / 2, 17)  # from pole to pole
_SEEN: Final = 0.05  # of opacity, less of which nobody sees
_SHOWN: Final = 2  # the last group of geoms that MuJoCo's viewer shows at first
_UNPAINTED: Final = (0.5, 0.5, 0.5, 1.0)  # of a geom, where no file has a colour of it


@dataclass(frozen=True)
class LinkMesh:
    """Triangles of one colour, fixed to a joint's frame."""

    joint: int  # 0-based; -1 is the fixed base
    vertices: FloatArray  # (V, 3) [m]
    faces: IntArray  # (F, 3)
    colour: Colour | None = None  # None: the file has none


@dataclass(frozen=True)
class Drawing:
    """What a page draws of an arm."""

    meshes: tuple[LinkMesh, ...] = ()
    capsules: tuple[Capsule, ...] = ()  # where nothing else is drawn
    lost: tuple[str, ...] = ()  # meshes of the file that are not there, or cannot be read


class _Part(NamedTuple):
    link: str
    surface: Surface  # in the frame of the link


def drawing_of(model: RobotModel) -> Drawing:
    """Return how an arm looks; nothing of what its file draws by no shape at all.

    Args:
        model: The robot.
    """
    found, lost = _parts(model.description)
    at = {frame.name: frame for frame in model.pin_tree.frames if frame.type == pin.FrameType.BODY}
    meshes = [
        LinkMesh(int(frame.parentJoint) - 1, *_in_frame(part.surface, frame.placement))
        for part in found
        if (frame := at.get(part.link)) is not None
    ]
    gone = {int(at[link].parentJoint) - 1 for link in lost if link in at}
    drawn = {mesh.joint for mesh in meshes}
    instead, capsules = _collision_shapes(model, None if not meshes else gone - drawn)
    names = tuple(dict.fromkeys(name for names in lost.values() for name in names))
    return Drawing(_thinned(_merged([*meshes, *instead])), capsules, names)


def _in_frame(surface: Surface, placement: pin.SE3) -> Surface:
    return surface.placed(np.array(placement.rotation), np.array(placement.translation))


def _parts(description: RobotDescription) -> tuple[list[_Part], dict[str, list[str]]]:
    """Return what a file draws, and by link the meshes that are lost."""
    lost: dict[str, list[str]] = {}
    if description.kind == "MJCF":
        try:
            return list(_geoms(description)), lost
        except ConfigError:  # the file has changed since it was read
            return [], lost
    painted = {str(x.get("name")): x for x in description.root.findall("material")}
    parts = [
        _Part(str(link.get("name")), surface)
        for link in description.root.findall("link")
        for visual in link.findall("visual")
        for surface in _visual(visual, str(link.get("name")), description, lost, painted)
    ]
    return parts, lost


def _collision_shapes(
    model: RobotModel, joints: set[int] | None
) -> tuple[list[LinkMesh], tuple[Capsule, ...]]:
    """Return hulls of the shapes at some joints, or all, and capsules of those that are round."""
    if joints is not None and not joints:
        return [], ()
    try:
        shapes = model.shapes
    except ConfigError:  # meshes that are not there
        return [], ()
    hulls, capsules = list[LinkMesh](), list[Capsule]()
    items = zip(shapes.capsules, shapes.round, shapes.geometry.geometryObjects, strict=True)
    for capsule, is_round, item in items:
        if joints is not None and capsule.joint not in joints:
            continue
        if is_round:
            capsules.append(capsule)
        else:
            surface = _in_frame(_hull(corners_of(item.geometry)), item.placement)
            hulls.append(LinkMesh(capsule.joint, *surface))
    return hulls, tuple(capsules)


def _visual(
    visual: ET.Element,
    link: str,
    description: RobotDescription,
    lost: dict[str, list[str]],
    painted: dict[str, ET.Element],
) -> Iterator[Surface]:
    """Yield the surfaces of a visual shape of a URDF."""
    origin, colour = visual.find("origin"), _material(visual.find("material"), painted)
    stated = {} if origin is None else origin.attrib
    place, R = (
        _numbers(stated.get("xyz", "0 0 0")),
        rotation_of(_numbers(stated.get("rpy", "0 0 0"))),
    )
    mesh = visual.find("geometry/mesh")
    if mesh is None:
        own = _primitive(visual.find("geometry"))
    else:
        name = str(mesh.get("filename"))
        file, scale = mesh_file(description, name), _numbers(mesh.get("scale", "1 1 1"))
        own = [] if file is None else [_scaled(each, scale) for each in read_mesh(file)]
        if not own:
            lost.setdefault(link, []).append(name)
    for surface in own:
        yield surface.placed(R, place)._replace(colour=colour or surface.colour)


def _material(stated: ET.Element | None, painted: dict[str, ET.Element]) -> Colour | None:
    if stated is None:
        return None
    for element in (stated, painted.get(str(stated.get("name")))):
        colour = None if element is None else element.find("color")
        if colour is not None:
            return _colour(_numbers(colour.get("rgba", "")))
    return None


def _colour(rgba: Sequence[float] | FloatArray) -> Colour | None:
    if len(rgba) != 4:  # noqa: PLR2004  # red, green, blue, opacity
        return None
    r, g, b, a = np.clip(rgba, 0.0, 1.0).tolist()
    return r, g, b, a


def _numbers(text: str) -> FloatArray:
    return np.array([float(part) for part in text.split()])


def _primitive(geometry: ET.Element | None) -> list[Surface]:
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        return []
    if shape.tag == "box":
        return [_box(_numbers(shape.get("size", "0 0 0")) / 2)]
    radius, length = float(shape.get("radius", "0")), float(shape.get("length", "0"))
    if shape.tag == "cylinder":
        return [_cylinder(radius, length / 2)]
    return [_rounded(radius, length / 2)] if shape.tag in {"sphere", "capsule"} else []


def _geoms(description: RobotDescription) -> Iterator[_Part]:
    """Yield the geoms of an MJCF that MuJoCo's viewer shows at first; all, where it shows none."""
    from limo_driver.model.descriptions.mjcf.arm import compiled_mjcf
    from limo_driver.model.descriptions.mjcf.joints import body_name

    model = compiled_mjcf(description.path)
    bodies = [body_name(model, body) for body in range(model.nbody)]
    own = [g for g in range(model.ngeom) if bodies[int(model.geom_bodyid[g])] in description.shifts]
    shown = [g for g in own if int(model.geom_group[g]) <= _SHOWN] or own
    for geom in shown:
        surface, link = _geom(model, geom), bodies[int(model.geom_bodyid[geom])]
        colour = _paint(model, geom)
        if surface is not None and (colour is None or colour[3] > _SEEN):
            R = np.array(pin.Quaternion(*model.geom_quat[geom].tolist()).toRotationMatrix())
            place = np.array(model.geom_pos[geom]) - description.shifts[link]
            yield _Part(link, surface.placed(R, place)._replace(colour=colour))


def _geom(model: Any, geom: int) -> Surface | None:  # noqa: ANN401
    from limo_driver.model.descriptions.mjcf.writer import vertices
    from limo_driver.runtime.installed_mujoco import mujoco

    kinds, kind = mujoco.mjtGeom, int(model.geom_type[geom])
    x, y, z = model.geom_size[geom].tolist()
    if kind == int(kinds.mjGEOM_MESH):
        mesh = int(model.geom_dataid[geom])
        first, many = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        faces = np.array(model.mesh_face[first : first + many], dtype=np.int64)
        return Surface(vertices(model, geom), faces)
    return {
        int(kinds.mjGEOM_BOX): lambda: _box(np.array([x, y, z])),
        int(kinds.mjGEOM_CYLINDER): lambda: _cylinder(x, y),
        int(kinds.mjGEOM_CAPSULE): lambda: _rounded(x, y),
        int(kinds.mjGEOM_SPHERE): lambda: _rounded(x, 0.0),
        int(kinds.mjGEOM_ELLIPSOID): lambda: _scaled(_rounded(1.0, 0.0), np.array([x, y, z])),
    }.get(kind, lambda: None)()


def _paint(model: Any, geom: int) -> Colour | None:  # noqa: ANN401
    """Return the colour of a geom as MuJoCo's viewer has it: its own, else its material's."""
    own, material = model.geom_rgba[geom], int(model.geom_matid[geom])
    if not np.allclose(own, _UNPAINTED):
        return _colour(own)
    return None if material < 0 else _colour(model.mat_rgba[material])


def _hull(points: FloatArray) -> Surface:
    from scipy.spatial import ConvexHull

    return Surface(points, np.asarray(ConvexHull(points).simplices, dtype=np.int64))


def _box(half: FloatArray) -> Surface:
    return _hull(np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half)


def _cylinder(radius: float, half: float) -> Surface:
    return _revolved(np.array([[0, -half], [radius, -half], [radius, half], [0, half]]))


def _rounded(radius: float, half: float) -> Surface:
    """Return a capsule; a sphere, if half the length of its segment is 0."""
    ends = np.where(np.sin(_ARC) < 0, -half, half)
    profile = np.stack([radius * np.cos(_ARC), radius * np.sin(_ARC) + ends], axis=1)
    return _revolved(np.insert(profile, _ARC.size // 2, [radius, -half], axis=0))


def _scaled(surface: Surface, size: FloatArray) -> Surface:
    return surface._replace(vertices=surface.vertices * size)


def _revolved(profile: FloatArray) -> Surface:
    """Return what a line (K, 2) of radii and heights [m] makes, turned about z."""
    k, n = len(profile), _AROUND.size
    ring = np.stack([np.cos(_AROUND), np.sin(_AROUND)], axis=1)
    flat = profile[:, None, :1] * ring
    high = np.broadcast_to(profile[:, None, 1:], (k, n, 1))
    a = np.arange((k - 1) * n)
    b = a - a % n + (a + 1) % n
    faces = np.concatenate([np.stack([a, b, b + n], axis=1), np.stack([a, b + n, a + n], axis=1)])
    return Surface(np.concatenate([flat, high], axis=2).reshape(-1, 3), faces)


def _merged(meshes: Iterable[LinkMesh]) -> list[LinkMesh]:
    """Return meshes of which each joint has one a colour."""
    groups: dict[tuple[int, Colour | None], list[LinkMesh]] = {}
    for mesh in meshes:
        if len(mesh.faces):
            groups.setdefault((mesh.joint, mesh.colour), []).append(mesh)
    found = list[LinkMesh]()
    for (joint, colour), own in groups.items():
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in own[:-1])])
        faces = [mesh.faces + at for mesh, at in zip(own, first, strict=True)]
        vertices = np.concatenate([mesh.vertices for mesh in own])
        found.append(LinkMesh(joint, vertices, np.concatenate(faces), colour))
    return found


def _thinned(meshes: list[LinkMesh]) -> tuple[LinkMesh, ...]:
    edge, meshes = _FINEST, [clustered(mesh, _FINEST) for mesh in meshes]
    while (many := sum(len(mesh.faces) for mesh in meshes)) > TRIANGLES:
        edge *= max(_COARSER, 0.9 * (many / TRIANGLES) ** 0.5)  # as many cells meet a surface
        meshes = [clustered(mesh, edge) for mesh in meshes if len(mesh.faces)]
    return tuple(mesh for mesh in meshes if len(mesh.faces))


def clustered(mesh: LinkMesh, edge: float) -> LinkMesh:
    """Join the vertices of each cell of a grid, and drop the triangles that vanish.

    Args:
        mesh: What to thin.
        edge: Of a cell [m].

    Source: J. Rossignac and P. Borrel, "Multi-resolution 3D approximations for rendering complex
    scenes", 1993.
    """
    cells = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / edge).astype(np.int64)
    y, z = cells.max(axis=0)[1:] + 1
    _, cell = np.unique((cells[:, 0] * y + cells[:, 1]) * z + cells[:, 2], return_inverse=True)
    faces = cell[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    turned = np.argmin(faces, axis=1)[:, None]  # the same triangle begins with the same corner
    a, b, c = np.take_along_axis(faces, (turned + np.arange(3)) % 3, axis=1).T
    many = int(cell.max()) + 1
    a, bc = np.divmod(np.unique((a * many + b) * many + c), many**2)
    used, faces = np.unique(np.stack([a, bc // many, bc % many], axis=1), return_inverse=True)
    count = np.bincount(cell).astype(float)
    sums = [(np.bincount(cell, column) / count)[used] for column in mesh.vertices.T]
    return replace(mesh, vertices=np.stack(sums, axis=1), faces=faces.reshape(-1, 3))
