"""RobotDescription: a robot as its file states it, whatever the format.

XML of strangers: parsed without entities, which could fill the memory or read other files.

The readers that descriptions are written for (tinyxml) take more than XML allows: "--" in comments,
prefixes that nobody declares, attributes without a space between them, blanks or comments before
the declaration. So does limo.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NamedTuple, NoReturn
from xml.etree import ElementTree as ET
from xml.parsers import expat

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.runtime.given_files import read_bytes, text_of
from limo_driver.types import FloatArray, readonly

_MARK: Final = "#"  # between the path of a description and the joints that are chosen
SITE: Final = "site_"  # begins the link that stands for a site of an MJCF file
ROOM: Final = 1.0  # [m] to either side, of a slide that states no range
DOWN: Final = (0.0, 0.0, -9.81)  # [m/s²]
_NOT_PARSED: Final = ("mimic", "safety_controller", "calibration")  # of joints


class StatedBristles(NamedTuple):
    """LuGre friction of a joint."""

    stiffness: float  # [N m/rad]
    damping: float  # [N m s/rad]
    sliding: float  # [N m]
    breakaway: float  # [N m]
    speed: float  # [rad/s], over which breakaway fades to sliding


class StatedSlip(NamedTuple):
    """A spring of a joint that slips where it is bent far enough: a Maxwell-slip element."""

    stiffness: float  # [N m/rad]
    width: float  # [rad], deflection at which it slips


class StatedRipple(NamedTuple):
    """Torque on a joint that repeats with its angle: amplitude sin(cycles q + phase)."""

    amplitude: float  # [N m]
    cycles: float  # [1/rev]
    phase: float  # [rad]


@dataclass(frozen=True)
class JointDynamics:
    """What a description states of the physics of one joint; 0 where it states nothing."""

    friction: float = 0.0  # [N m], dry
    damping: float = 0.0  # [N m s/rad]
    armature: float = 0.0  # [kg m²]
    stiffness: float = 0.0  # [N m/rad], of a spring
    rest: float = 0.0  # [rad], where the spring has no pull
    cubic: float = 0.0  # [N m/rad³], by which that spring stiffens
    drag: float = 0.0  # [N m s²/rad²], in proportion to the square of the speed
    bristles: tuple[StatedBristles, ...] = ()
    slips: tuple[StatedSlip, ...] = ()
    ripples: tuple[StatedRipple, ...] = ()
    gap: float = 0.0  # [rad], of a play
    gap_damping: float = 0.0  # [N m s/rad], of the fall across it


@dataclass(frozen=True)
class StatedServo:
    """What a description states of the servo of one joint; one of velocity has a kp of 0."""

    kp: float  # [N m/rad]
    kd: float  # [N m s/rad]
    limit: float | None  # [N m]
    delay: float = 0.0  # [s]
    beside: float = 0.0  # [N m s/rad] of kd, by actuators of velocity beside one of position
    limited: frozenset[str] = frozenset()  # of `force` and `ctrl`, what its actuator limits


@dataclass(frozen=True)
class StatedMotor:
    """What a description states of an actuator of torque on one joint."""

    gain: float  # torque at the joint over the command
    limit: float | None  # [N m]
    delay: float = 0.0  # [s]
    limited: frozenset[str] = frozenset()  # as that of a servo


class Following(NamedTuple):
    """How a joint follows another: its position is ratio times that of the leader, plus offset."""

    leader: str
    ratio: float
    offset: float  # [rad, m]


@dataclass(frozen=True)
class RobotDescription:
    """A robot as its file states it.

    Args:
        root: As URDF, with every joint that is not chosen fixed.
        path: The file.
        kind: `URDF` or `MJCF`.
        dynamics: Of joints, by name.
        gravity: In the frame of the base [m/s²].
        shifts: From the frame of each body of the file to that of the link here, by name [m].
        servos: Servos of position and velocity, by the joint that they move.
        motors: Actuators of torque, likewise.
        plays: Joints that are the play of others, by those.
        locked: Where joints are locked that could move, by name [rad, m].
        followers: Joints that move as others do, by name; those others move on their own.
        led: Of each locked joint that is where another one is, that other one.
        hulls: Corners of each mesh that stands as a box in `root`, (K, 3) [m], in the frame of that
            box; by name of the link and number of the shape on it, `hand_0`.
        loops: Names of the joints of each loop that bodies close, which a tree of links cannot.
        unranged: Joints that move on their own and state no range, for which one was made up.
        places: Where MuJoCo's arrays of positions and of velocities have each joint, by name.
        widths: Of those arrays of positions and velocities.
        notes: What was locked or left aside, and what the file cannot be taken at its word for.
    """

    root: ET.Element
    path: Path
    kind: str = "URDF"
    dynamics: dict[str, JointDynamics] = field(default_factory=dict)
    gravity: tuple[float, float, float] = DOWN
    shifts: dict[str, FloatArray] = field(default_factory=dict)
    hulls: dict[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    servos: dict[str, StatedServo] = field(default_factory=dict)
    motors: dict[str, StatedMotor] = field(default_factory=dict)
    plays: dict[str, str] = field(default_factory=dict)
    locked: dict[str, float] = field(default_factory=dict)
    followers: dict[str, Following] = field(default_factory=dict)
    led: dict[str, str] = field(default_factory=dict)
    loops: tuple[frozenset[str], ...] = ()
    unranged: tuple[str, ...] = ()
    places: dict[str, tuple[int, int]] = field(default_factory=dict)
    widths: tuple[int, int] = (0, 0)

    @property
    def text(self) -> str:
        """The description as URDF."""
        return ET.tostring(self.root, encoding="unicode")

    def without(self, *tags: str) -> ET.Element:
        """Return a copy of `root` for parsers, without some elements of it and of its links.

        It also lacks what limo reads itself, or nobody: parsers refuse all where that is odd, and
        say why in lines of their own.

        Args:
            tags: Such as `visual`: of shapes that pinocchio's parser cannot read, it says many
                lines, and of materials that it has twice, it refuses all.
        """
        root = deepcopy(self.root)
        root.attrib.pop("version", None)
        for owner in (root, *root.findall("link"), *root.findall("joint")):
            for element in [each for each in owner if each.tag in (*tags, *_NOT_PARSED)]:
                owner.remove(element)
        return root

    def jerk_of(self, joints: Sequence[str]) -> FloatArray | None:
        """Return the jerk in the limit of each joint, (n,) [rad/s^3]; None if none states any.

        Args:
            joints: Their names, (n,); the jerk of those that state none is inf.

        Raises:
            ConfigError: It is not above 0.
        """
        jerk = np.full(len(joints), np.inf)
        for joint in self.root.findall("joint"):
            limit, name = joint.find("limit"), str(joint.get("name"))
            if limit is None or name not in joints or (stated := limit.get("jerk")) is None:
                continue
            if (value := float(stated)) <= 0.0:
                raise ConfigError(
                    f"joint {name!r}: jerk of its limit is {stated}, expected a number above 0",
                    path=self.path,
                )
            jerk[joints.index(name)] = value
        return readonly(jerk) if np.isfinite(jerk).any() else None


def split_reference(reference: str) -> tuple[str, tuple[str, ...]]:
    """Return the path in a reference to a robot, and the joints that it chooses.

    `panda.urdf#panda_joint*` are the joints of the panda whose names match; `gripper=0.02` among
    them locks that joint at that position; all other joints are locked as near to zero as they can
    be.
    """
    path, mark, joints = reference.partition(_MARK)
    chosen = tuple(part.strip() for part in joints.split(",") if part.strip())
    return (path, chosen) if mark else (reference, ())


def joined_reference(path: str, joints: Sequence[str]) -> str:
    """Return a reference that `split_reference` takes apart."""
    return f"{path}{_MARK}{','.join(joints)}" if joints else path


MOST_JOINTS = 1000  # elements, also of what refers to joints
_DEEPEST = 500  # levels, as MuJoCo and urdfdom read; more end what parses them one in the other
_MOST_PARTS = 1_000_000  # elements and attributes; meshes are files of their own
_OUTERMOST: Final = re.compile(r"<[A-Za-z_][\w.:-]*")
_MARKS: Final = {"<!--": "-->", "<![CDATA[": "]]>", "<?": "?>"}
_TAG: Final = re.compile(r"""<(?:[^"'>]|"[^"]*"|'[^']*')*+>""")
_QUOTED: Final = re.compile(r"""("[^"]*"|'[^']*')(?=([^\s/>?])?)""")
_ENCODING: Final = re.compile(rb"""<\?xml[^>]*\bencoding\s*=\s*["']([\w.-]+)["']""")
_DECLARATION: Final = re.compile(r"<\?xml[^>]*>")  # which no text needs that is decoded
_ENCODINGS: Final = ("utf-16", "iso-8859-1", "iso-8859-15", "latin-1", "latin1", "windows-1252")
_MARKED_16: Final = (b"\xff\xfe", b"\xfe\xff")
_PREFIX: Final = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[A-Za-z_]")


def read_xml(path: Path) -> ET.Element:
    """Parse a file.

    Args:
        path: The file.

    Raises:
        ConfigError: It is no XML, too large, nested too deep, or declares entities.
    """
    text = _decoded(read_bytes(path, ConfigError), path)
    if (parts := text.count("<") + text.count("=")) > _MOST_PARTS:
        raise ConfigError(
            f"has {parts} elements and attributes, expected at most {_MOST_PARTS}", path=path
        )
    if (joints := text.count("<joint")) > MOST_JOINTS:
        raise ConfigError(f"has {joints} joints, expected at most {MOST_JOINTS}", path=path)
    text = _as_xml(text)
    check_nesting(text, path)
    try:
        root = ET.fromstring(text)  # noqa: S314  # no entities are left by now
    except ET.ParseError as error:
        raise ConfigError(f"is no XML: {error}", path=path) from None
    # Name elements without the namespace of the outermost, which URDFs for Drake declare
    space, named, _ = root.tag.rpartition("}")
    if named:
        for element in root.iter():
            element.tag = element.tag.removeprefix(f"{space}}}")
    return root


def _decoded(data: bytes, path: Path) -> str:
    """Return the text of a file in UTF-8, or in the encoding that it declares.

    Raises:
        ConfigError: It is in neither.
    """
    stated = _ENCODING.match(data)
    encoding = "utf-16" if data.startswith(_MARKED_16) else ""
    encoding = encoding or (stated[1].decode().lower() if stated else "utf-8")
    if encoding not in _ENCODINGS:
        return text_of(data, path, ConfigError)
    return _DECLARATION.sub("", data.decode(encoding, errors="replace"), count=1)


def _as_xml(text: str) -> str:
    """Return a text with what its readers overlook made XML, each line where it was."""
    text = "".join(_pieces(text.rstrip("\0")))
    outermost = _OUTERMOST.search(text)
    if outermost is None:
        return text
    head = text[outermost.end() : text.find(">", outermost.end())]
    declared = {"xml", "xmlns", *re.findall(r"\bxmlns:([\w.-]+)", head)}
    used = dict.fromkeys(_PREFIX.findall(text))
    own = "".join(f' xmlns:{prefix}="{prefix}"' for prefix in used if prefix not in declared)
    return text[: outermost.end()] + own + text[outermost.end() :]


def _pieces(text: str) -> Iterator[str]:
    """Yield a text piece by piece, as its readers take it apart: what is quoted begins nothing.

    Else an element could hide from us between two quoted halves of a comment, and not from them.
    What ends nowhere is left as it is, for the parser to refuse.
    """
    at = 0
    while (start := text.find("<", at)) >= 0:
        yield text[at:start]
        mark = next((mark for mark in _MARKS if text.startswith(mark, start)), "")
        tag = None if mark else _TAG.match(text, start)
        end = text.find(_MARKS[mark], start + len(mark)) if mark else -1
        if tag is None and end < 0:
            yield text[start:]
            return
        at = end + len(_MARKS[mark]) if tag is None else tag.end()
        piece = text[start:at]
        if mark == "<!--" or (start and piece.startswith("<?xml")):
            yield "\n" * piece.count("\n")
        else:
            yield piece if mark else _QUOTED.sub(lambda x: x[1] + " " * bool(x[2]), piece)
    yield text[at:]


def check_nesting(text: str, path: Path) -> None:
    """Refuse what no description needs: declarations of entities, and very deep nesting.

    Raises:
        ConfigError: There is one, or the text is no XML.
    """
    parser, depth = expat.ParserCreate(), 0

    def refuse(problem: str) -> NoReturn:
        raise ConfigError(
            f"{problem}, which no description needs", path=path, line=parser.CurrentLineNumber
        )

    def begin(*_: object) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            refuse(f"is nested deeper than {_DEEPEST} levels")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def declare(name: str, *_: object) -> None:
        refuse(f"declares the entity {name!r}")

    parser.EntityDeclHandler = declare
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        raise ConfigError(f"is no XML: {error}", path=path) from None
