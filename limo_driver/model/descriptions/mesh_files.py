"""Mesh files as surfaces of one colour each: STL, OBJ and COLLADA, and what else assimp reads."""

# coal has no stubs; this file is the adapter to its loader.
# pyright: reportMissingImports=false
from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple
from xml.etree import ElementTree as ET

import coal
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from limo_driver.types import FloatArray

# Of a binary STL: 80 bytes, the number of triangles, and each of them with its normal.
_STL: Final = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
_STL_HEAD: Final = 84
_POLYGONS: Final = ("triangles", "polylist", "polygons")  # of COLLADA
_CORNERS: Final = 3

Colour = tuple[float, float, float, float]  # red, green, blue and opacity, 0 to 1


class Surface(NamedTuple):
    """Triangles of one colour."""

    vertices: FloatArray  # (V, 3) [m]
    faces: NDArray[np.int64]  # (F, 3)
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
