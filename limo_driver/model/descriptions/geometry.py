"""Poses and inertias of bodies, as descriptions state them.

Mesh files as surfaces of one colour each: STL, OBJ and COLLADA, and what else assimp reads.
"""

# coal has no stubs; this file is the adapter to its loader.
# pyright: reportMissingImports=false

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple
from xml.etree import ElementTree as ET

import coal
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import pinocchio as pin

    from limo_driver.types import FloatArray, IntArray

# pinocchio has no stubs and is found through an import hook.
# pyright: reportMissingImports=false, reportUnknownParameterType=false
_ROUNDING = 1e-9  # of the largest second moment
_THIN = 1e-4  # of the largest second moment, that a body which was none gets at least
_GRAIN = 1e-3  # [m], root mean square extent of what stands for a point mass along each axis


def numbers(values: FloatArray | Sequence[float]) -> str:
    """Return numbers as they stand in XML."""
    return " ".join(repr(float(value)) for value in values)


def rotation_of(rpy: FloatArray) -> FloatArray:
    """Return the rotation matrix of roll, pitch and yaw [rad], (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def rpy_of(R: FloatArray) -> FloatArray:
    """Return roll, pitch and yaw [rad] of a rotation matrix, (3,)."""
    from scipy.spatial.transform import Rotation

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # at a pitch of 90 degrees any of the angles will do
        return np.asarray(Rotation.from_matrix(R).as_euler("xyz"))


def turned(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation about a unit axis by an angle [rad], (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(axis * angle).as_matrix())


@dataclass(frozen=True)
class Inertial:
    """Inertia of all that moves rigidly with one joint, in the frame of its link."""

    mass: float  # [kg]
    com: tuple[float, float, float]  # [m]
    inertia: tuple[float, float, float, float, float, float]  # at the com: xx xy xz yy yz zz

    @classmethod
    def of_pinocchio(cls, inertia: pin.Inertia) -> Inertial:
        """Return what pinocchio has for a link."""
        tensor = np.array(inertia.inertia)
        return cls(
            mass=float(inertia.mass),
            com=tuple(np.array(inertia.lever).tolist()),
            inertia=tuple(tensor[np.triu_indices(3)].tolist()),
        )

    def tensor(self) -> FloatArray:
        """Return the 3 × 3 inertia tensor at the centre of mass [kg m²]."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def is_consistent(self) -> bool:
        """Say whether mass and inertia are physically consistent, as those of some rigid body.

        True if the mass is positive and the density-weighted covariance is positive definite,
        which for the tensor means positive principal moments that satisfy the triangle inequality.
        """
        return bool(self.mass > 0 and self._second_moments().min() > 0)

    def is_possible(self) -> bool:
        """Say whether it can be fixed to a link: a rigid body, a rod, a point mass or nothing."""
        moments = self._second_moments()
        largest = float(np.abs(moments).max())
        massive = self.mass > 0 or (self.mass == 0 and largest == 0)
        return bool(massive and moments.min() >= -_ROUNDING * largest)

    def has_extent(self) -> bool:
        """Say whether it is a rigid body that resists turning about every axis."""
        return self.is_possible() and bool(np.linalg.eigvalsh(self.tensor()).min() > 0)

    def nearest_consistent(self) -> Inertial:
        """Return the rigid body of the same mass and centre whose inertia is nearest.

        A principal moment above the sum of the others asks for less than no extent along its axis;
        the body gets next to none there, as a thin plate has. A point mass becomes a grain.
        """
        moments, axes = np.linalg.eigh(self._covariance())
        least = _THIN * moments.max() if moments.max() > 0 else self.mass * _GRAIN**2
        moments = np.maximum(moments, least)
        covariance = (axes * moments) @ axes.T
        tensor = np.trace(covariance) * np.eye(3) - covariance
        xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
        return replace(self, inertia=(xx, xy, xz, yy, yz, zz))

    def joined(self, other: Inertial) -> Inertial:
        """Return both bodies as one; both in the frame of the same link."""
        mass = self.mass + other.mass
        com = (self.mass * np.array(self.com) + other.mass * np.array(other.com)) / mass
        tensor = self._tensor_at(com) + other._tensor_at(com)
        x, y, z = com.tolist()
        xx, xy, xz, yy, yz, zz = tensor[np.triu_indices(3)].tolist()
        return Inertial(mass, (x, y, z), (xx, xy, xz, yy, yz, zz))

    def moved(self, pose: FloatArray) -> Inertial:
        """Return this body, given in the frame at a pose, as another frame has it.

        Args:
            pose: Of its own frame in the other, homogeneous, (4, 4) [m].
        """
        R = pose[:3, :3]
        x, y, z = (R @ np.array(self.com) + pose[:3, 3]).tolist()
        turned = R @ self.tensor() @ R.T
        xx, xy, xz, yy, yz, zz = turned[np.triu_indices(3)].tolist()
        return Inertial(self.mass, (x, y, z), (xx, xy, xz, yy, yz, zz))

    def _second_moments(self) -> FloatArray:
        """Return the principal values of ∫ρ x xᵀ about the centre of mass, (3,) [kg m²]."""
        return np.linalg.eigvalsh(self._covariance()).astype(np.float64)

    def _covariance(self) -> FloatArray:
        """Return ∫ρ x xᵀ about the centre of mass, (3, 3) [kg m²]."""
        tensor = self.tensor()
        return 0.5 * np.trace(tensor) * np.eye(3) - tensor

    def _tensor_at(self, point: FloatArray) -> FloatArray:
        """Return the inertia tensor about a point, by Steiner's theorem, (3, 3) [kg m²]."""
        d = np.array(self.com) - point
        return self.tensor() + self.mass * (d @ d * np.eye(3) - np.outer(d, d))


# Of a binary STL: 80 bytes, the number of triangles, and each of them with its normal.
_STL: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
_STL_HEAD: Final = 84
_POLYGONS: Final = ("triangles", "polylist", "polygons")  # of COLLADA
_CORNERS: Final = 3

Colour = tuple[float, float, float, float]  # red, green, blue and opacity, 0 to 1


class Surface(NamedTuple):
    """Triangles of one colour."""

    vertices: FloatArray  # (V, 3) [m]
    faces: IntArray  # (F, 3)
    colour: Colour | None = None  # None: no file has one

    def placed(self, R: FloatArray, place: FloatArray) -> Surface:
        """Return it turned and moved."""
        return self._replace(vertices=self.vertices @ R.T + place)


def read_mesh(file: Path) -> list[Surface]:
    """Return the surfaces of a mesh file; none of one that cannot be read.

    Args:
        file: The file, which is there.
    """
    kind = file.suffix.lower()
    try:
        if kind == ".stl" and (surface := _of_stl(file.read_bytes())) is not None:
            return [surface]
        if kind == ".obj":
            return _of_obj(file)
        loaded = coal.MeshLoader().load(str(file), np.ones(3))
        corners = (loaded.tri_indices(k) for k in range(loaded.num_tris))
        faces = np.array([[t[0], t[1], t[2]] for t in corners], dtype=np.int64).reshape(-1, 3)
        whole = Surface(np.array(loaded.vertices()).reshape(-1, 3), faces)
        return _painted(whole, file) if kind == ".dae" else [whole]
    except (OSError, ValueError, RuntimeError, LookupError):
        return []


def _of_stl(data: bytes) -> Surface | None:
    """Return the triangles of a binary STL; None of a text."""
    many = (len(data) - _STL_HEAD) // _STL.itemsize
    if many < 1 or data[80:_STL_HEAD] != many.to_bytes(4, "little"):
        return None
    corners = np.frombuffer(data, _STL, many, _STL_HEAD)["corners"].reshape(-1, 3)
    return Surface(corners.astype(np.float64), np.arange(3 * many).reshape(-1, 3))


def _of_obj(file: Path) -> list[Surface]:
    places, colours = list[list[float]](), dict[str, Colour]()
    faces: dict[str, list[list[int]]] = {}
    material = ""
    for line in file.read_text(errors="replace").splitlines():
        key, *words = line.split() or [""]
        if key == "v":
            places.append([float(x) for x in words[:3]])
        elif key == "usemtl":
            material = " ".join(words)
        elif key == "mtllib" and (library := file.parent / " ".join(words)).is_file():
            colours |= _of_mtl(library.read_text(errors="replace"))
        elif key == "f":
            at = [int(word.partition("/")[0]) for word in words]
            corners = [k - 1 if k > 0 else len(places) + k for k in at]
            fan = pairwise(corners[1:])
            faces.setdefault(material, []).extend([corners[0], b, c] for b, c in fan)
    vertices = np.array(places, dtype=np.float64)
    return [
        Surface(vertices, np.array(own, dtype=np.int64), colours.get(name))
        for name, own in faces.items()
    ]


def _of_mtl(text: str) -> dict[str, Colour]:
    found: dict[str, Colour] = {}
    name = ""
    for line in text.splitlines():
        key, *words = line.split() or [""]
        if key == "newmtl":
            name = " ".join(words)
        elif key == "Kd":
            r, g, b = (float(x) for x in words[:3])
            found[name] = (r, g, b, 1.0)
    return found


def _painted(whole: Surface, file: Path) -> list[Surface]:
    """Return the parts of a COLLADA file as they were meant, each in its colour.

    coal appends the parts of a file in their order, drops colours, and numbers the corners of all
    parts of a node from that node's first. Where it joined other parts, all has the colour of most.
    """
    parts = list(_parts(ET.parse(file).getroot()))  # noqa: S314  # assimp has read it already
    many = [count for count, _ in parts]
    if not parts:
        return [whole]
    most = whole._replace(colour=max(parts, key=lambda part: part[0])[1])
    if sum(many) != len(whole.faces):
        return [most]
    found, first = list[Surface](), 0
    for faces, (_, colour) in zip(np.split(whole.faces, np.cumsum(many)[:-1]), parts, strict=True):
        if faces.size:
            own = faces - faces.min()
            found.append(Surface(whole.vertices, own + first, colour))
            first += int(own.max()) + 1
    return found if first == len(whole.vertices) else [most]


def _parts(root: ET.Element) -> Iterator[tuple[int, Colour | None]]:
    """Yield triangles and colours of all that the scene shows, nodes in their order."""
    by_id = {str(x.get("id")): x for x in root.iter() if x.get("id")}
    for instance in root.iterfind(".//{*}visual_scene//{*}instance_geometry"):
        bound = {
            str(x.get("symbol")): str(x.get("target"))[1:]
            for x in instance.iterfind(".//{*}instance_material")
        }
        mesh = by_id[str(instance.get("url"))[1:]].find("{*}mesh")
        for part in mesh if mesh is not None else ():
            if part.tag.partition("}")[2] in _POLYGONS:
                material = by_id.get(bound.get(str(part.get("material")), ""))
                yield _triangles(part), _diffuse(material, by_id)


def _triangles(part: ET.Element) -> int:
    """Return into how many triangles a part falls."""
    corners = part.findtext("{*}vcount")
    if corners is not None:
        return int((np.array(corners.split(), dtype=int) - _CORNERS + 1).sum())
    return int(part.get("count", "0"))


def _diffuse(material: ET.Element | None, by_id: dict[str, ET.Element]) -> Colour | None:
    effect = None if material is None else material.find("{*}instance_effect")
    if effect is None:
        return None
    colour = by_id[str(effect.get("url"))[1:]].findtext(".//{*}diffuse/{*}color")
    if colour is None:
        return None  # a picture
    r, g, b, *_ = (float(x) for x in colour.split())
    return r, g, b, 1.0
