"""The arm on a page: its links and joints, what was found where, and the motion that is played."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from limo_driver.model import Capsule, RobotModel
from limo_driver.model.descriptions.shapes import enclosing_capsule
from limo_driver.model.drawn import Drawing, LinkMesh, drawing_of
from limo_driver.model.kinematics import KinematicChain
from limo_driver.pages.markup import typeset
from limo_driver.types import FloatArray

STICK: Final = 0.03  # of the arm's length: radius of links that have no shape
RING: Final = 0.05  # of the arm's length: radius of the ring at a joint that has no shape
_WIDER: Final = 1.12  # of the ring than of the link it goes around
_OVER: Final = 1.5  # times that link, as far as a ring goes around a thicker one below it
_WIDE: Final = 65_535  # vertices, beyond which numbers of 16 bits do not count them


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
    capsules: tuple[Capsule, ...]  # around all of its links
    drawing: Drawing  # in 3-D
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
                for c in self.drawing.capsules
            ],
            "meshes": [_mesh_values(mesh) for mesh in self.drawing.meshes],
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
    sticks, drawing = _sticks(chain, model.length), drawing_of(model)
    around = (*drawing.capsules, *(_around(mesh) for mesh in drawing.meshes))
    if not around or drawing.lost:
        drawn = {item.joint for item in around}
        bare = tuple(item for item in sticks if item.joint not in drawn)
        drawing, around = replace(drawing, capsules=(*drawing.capsules, *bare)), (*around, *bare)
    own = chain.linkage.own.tolist()
    rings = tuple(_ring(around, link, int(chain.parent[link]), model.length) for link in own)
    return ArmView(chain, around, drawing, rings, model.length, pose, **said)


def _around(mesh: LinkMesh) -> Capsule:
    found = enclosing_capsule(mesh.vertices)
    return Capsule("", mesh.joint, found.start, found.end, found.radius)


def _sticks(chain: KinematicChain, length: float) -> tuple[Capsule, ...]:
    """Return thin capsules from each joint to the next, and to the flange."""
    ends = [(int(p), t) for p, t in zip(chain.parent, chain.translation, strict=True)]
    ends.append((len(chain.parent) - 1, chain.flange))
    zero = np.zeros(3)
    return tuple(Capsule("", joint, zero, end, STICK * length) for joint, end in ends)


def _ring(capsules: Sequence[Capsule], link: int, parent: int, length: float) -> float:
    """Return the radius of a ring that is seen around a link, and around what it turns on."""
    own, below = (
        max((c.radius for c in capsules if c.joint == joint), default=0.0)
        for joint in (link, parent)
    )
    least = own or RING * length / _WIDER
    return _WIDER * max(least, min(below, _OVER * least))


def _mesh_values(mesh: LinkMesh) -> dict[str, Any]:
    """Return a mesh in 16 bits a coordinate, of the box around it."""
    low = mesh.vertices.min(axis=0)
    size = float(np.ptp(mesh.vertices, axis=0).max()) or 1.0
    values = np.round((mesh.vertices - low) / size * _WIDE).astype("<u2")
    return {
        "joint": mesh.joint,
        "low": _rounded(low, 6),
        "size": size,
        "vertices": _packed(values),
        "faces": _packed(mesh.faces.astype("<u4" if len(values) > _WIDE else "<u2")),
        "wide": len(values) > _WIDE,
        "colour": None if mesh.colour is None else _rounded(mesh.colour, 3),
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
