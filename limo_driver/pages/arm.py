"""The arm on a page: its links and joints, what was found where, and the motion that is played."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pinocchio as pin

from limo_driver.errors import ConfigError
from limo_driver.model import Capsule
from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages.markup import typeset

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from limo_driver.model import RobotModel
    from limo_driver.types import FloatArray

STICK: Final = 0.03  # of the arm's length: radius of links that have no shape
RING: Final = 0.05  # of the arm's length: radius of the ring at a joint that has no shape
_WIDER: Final = 1.12  # of the ring than of the link it goes around
# pinocchio has no stubs and is found through an import hook; this file is an adapter to it.
# pyright: reportMissingImports=false
TRIANGLES: Final = 16_000  # of all links: more make a page large, and cannot be seen
_COARSER: Final = 1.25  # by which the grid of vertices grows until that holds
_FINEST: Final = 0.002  # [m], edge of that grid


@dataclass(frozen=True)
class Pin:
    """A text at a joint (0-based), or at the flange if there is none."""

    text: str
    joint: int | None = None
    link: str = ""  # anchor in the page


@dataclass(frozen=True)
class Ghost:
    """Another arm beside the recorded one: what it did and what torque it lacked, T samples."""

    name: str
    colour: str
    error: FloatArray  # (T, n) recorded less simulated torque [N m]
    position: FloatArray | None = None  # (T, n) [rad], where it was simulated


@dataclass(frozen=True)
class PushArrow:
    """A force on the flange during a stretch of time."""

    start: float  # [s]
    end: float  # [s]
    force: tuple[float, ...]  # (3,) [N], in axes of the base


@dataclass(frozen=True)
class PlayedMotion:
    """The motion that the time slider goes through, T samples."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    ghosts: tuple[Ghost, ...] = ()
    pushes: tuple[PushArrow, ...] = ()
    caption: str = ""
    path: FloatArray | None = None  # (K, 3) [m], in axes of the base, drawn as a line


@dataclass(frozen=True)
class ArmView:
    """An arm as pages draw it, with what is said of its joints."""

    chain: KinematicChain
    capsules: tuple[Capsule, ...]
    meshes: tuple[LinkMesh, ...]
    rings: tuple[float, ...]  # (n,) radius of the ring around each joint [m]
    length: float  # [m]
    pose: FloatArray  # (n,) [rad], shown at first and on paper
    errors: tuple[tuple[str, tuple[float, ...]], ...] = ()  # by name, (n,) [N m] each
    floor: tuple[float, ...] = ()  # (n,) [N m], what an error is compared with
    scale: str = "1 to 100 times the noise floor"  # what the colours of rings stand for
    pins: tuple[Pin, ...] = ()
    motion: PlayedMotion | None = None

    def as_values(self) -> dict[str, Any]:
        """Return what the script of a page draws, as plain values."""
        chain = self.chain
        return {
            "parent": chain.parent.tolist(),
            "rotation": _rounded(chain.rotation, 9),
            "translation": _rounded(chain.translation, 6),
            "axis": _rounded(chain.direction, 9),
            "slides": chain.slides.tolist(),
            "driver": chain.linkage.driver.tolist(),
            "ratio": chain.linkage.ratio.tolist(),
            "offset": chain.linkage.offset.tolist(),
            "own": chain.linkage.own.tolist(),
            "flange": _rounded(chain.flange, 6),
            "length": self.length,
            "pose": _rounded(self.pose, 5),
            "rings": _rounded(self.rings, 4),
            "capsules": [
                [c.joint, *_rounded(c.start, 4), *_rounded(c.end, 4), round(c.radius, 4)]
                for c in self.capsules
            ],
            "meshes": [_mesh_values(mesh) for mesh in self.meshes],
            "errors": [[name, _rounded(values, 6)] for name, values in self.errors],
            "floor": _rounded(self.floor, 6),
            "pins": [
                {"text": typeset(p.text), "joint": p.joint, "link": p.link} for p in self.pins
            ],
            "motion": _motion_values(self.motion) if self.motion else None,
        }


def arm_view(model: RobotModel, pose: FloatArray, **said: Any) -> ArmView:  # noqa: ANN401
    """Return a robot as pages draw it: its meshes, else its capsules, else a stick figure.

    Args:
        model: The robot.
        pose: Shown at first and on paper, (n,) [rad].
        said: `errors`, `floor`, `pins` and `motion` of the view.
    """
    chain = KinematicChain.of(model)
    capsules = _capsules(model) or _sticks(chain, model.length)
    own = chain.linkage.own.tolist()
    rings = tuple(_ring(capsules, link, model.length) for link in own)
    return ArmView(chain, capsules, meshes_of(model), rings, model.length, pose, **said)


def _capsules(model: RobotModel) -> tuple[Capsule, ...]:
    try:
        return model.capsules()
    except ConfigError:  # meshes that are not there: the arm can be drawn without
        return ()


def _sticks(chain: KinematicChain, length: float) -> tuple[Capsule, ...]:
    """Return thin capsules from each joint to the next, and to the flange."""
    ends = [(int(p), t) for p, t in zip(chain.parent, chain.translation, strict=True)]
    ends.append((len(chain.parent) - 1, chain.flange))
    zero = np.zeros(3)
    return tuple(Capsule("", joint, zero, end, STICK * length) for joint, end in ends)


def _ring(capsules: Sequence[Capsule], link: int, length: float) -> float:
    radii = [c.radius for c in capsules if c.joint == link]
    return _WIDER * max(radii, default=RING * length / _WIDER)


def _mesh_values(mesh: LinkMesh) -> dict[str, Any]:
    """Return a mesh in 16 bits a coordinate, of the box around it."""
    low = mesh.vertices.min(axis=0)
    size = float(np.ptp(mesh.vertices, axis=0).max()) or 1.0
    values = np.round((mesh.vertices - low) / size * 65_535).astype("<u2")
    return {
        "joint": mesh.joint,
        "low": _rounded(low, 6),
        "size": size,
        "vertices": _packed(values),
        "faces": _packed(mesh.faces.astype("<u4" if len(values) > 65_535 else "<u2")),  # noqa: PLR2004
        "wide": len(values) > 65_535,  # noqa: PLR2004  # 16 bits
    }


def _motion_values(motion: PlayedMotion) -> dict[str, Any]:
    return {
        "time": _packed(motion.time.astype("<f4")),
        "position": _packed(motion.position.astype("<f4")),
        "ghosts": [
            {
                "name": ghost.name,
                "colour": ghost.colour,
                "error": _packed(ghost.error.astype("<f4")),
                "position": None
                if ghost.position is None
                # the difference, which single precision keeps where the position would drown it
                else _packed((ghost.position - motion.position).astype("<f4")),
            }
            for ghost in motion.ghosts
        ],
        "path": None if motion.path is None else _packed(motion.path.astype("<f4")),
        "pushes": [[p.start, p.end, *_rounded(p.force, 3)] for p in motion.pushes],
    }


def _packed(values: Any) -> str:  # noqa: ANN401  # arrays of any type
    return b64encode(np.ascontiguousarray(values).tobytes()).decode()


def _rounded(values: ArrayLike, digits: int) -> list[Any]:
    known = np.asarray(values, dtype=float)
    return np.where(np.isfinite(known), np.round(known, digits), 0.0).tolist()


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
