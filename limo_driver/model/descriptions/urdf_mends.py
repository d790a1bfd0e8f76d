"""What other readers of a URDF overlook, put right before it is checked, with a note.

An axis on a joint that does not move, a limit of -1 for none, a base that floats: each means one
thing alone, and costs nobody anything who only wants to see the arm move.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree as ET

from limo_driver.model.descriptions.description import ROOM
from limo_driver.model.descriptions.urdf_checks import NUMBERS, TEXTS, VECTORS, end_of
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

_MOVABLE: Final = ("revolute", "continuous", "prismatic")
_FREE: Final = ("floating", "planar")
_BALLS: Final = ("spherical", "ball")  # which other simulators write into URDFs
_OF_MOTION: Final = ("axis", "limit", "mimic", "dynamics", "safety_controller")
_MOST: Final = ("effort", "velocity")  # of a joint that moves
_SMALLEST: Final = 1e-300  # of a number; parsers refuse some that are smaller
_NEEDED: Final = {  # and what each needs
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "mesh": ("filename",),
}
_AXES: Final = 3
_REFUSED: Final = "without a range, the arm cannot be planned or run"


def mended(root: ET.Element, path: Path) -> tuple[str, ...]:
    """Put right what other readers overlook; return what to note.

    Args:
        root: Outermost element of a URDF, which is changed.
        path: The file, whose name is that of a robot without one.
    """
    root.attrib.setdefault("name", path.stem)
    return (
        *_without_lost_macros(root),
        *_on_the_ground(root),
        *_with_base(root),
        *_with_plain_joints(root),
        *_without_negative_friction(root),
        *_without_odd_shapes(root),
    )


def _without_lost_macros(root: ET.Element) -> Iterator[str]:
    """Take out calls of macros that nobody defines, as of sensors, which xacro could not expand."""
    called = [(owner, each) for owner in root.iter() for each in owner if _xacro(each)]
    names = list(dict.fromkeys(_xacro(each) for _, each in called))
    if {"macro", "include", "property", "arg"} & {*names}:
        return  # which `check_urdf` refuses
    for owner, element in called:
        owner.remove(element)
    if called:
        yield f"left aside: calls of macros that the file does not define, {shortened(names)}"


def _xacro(element: ET.Element) -> str:
    space, _, name = element.tag.rpartition("}")
    return name if "xacro" in space else ""


def _with_base(root: ET.Element) -> Iterator[str]:
    """Add the one link that is not stated and that fixed joints stand on: the base.

    URDFs for Drake are welded to a world so, and parts of robots to what carries them.
    """
    links = {str(link.get("name")) for link in root.findall("link")}
    joints = root.findall("joint")
    lost = {end_of(joint, "parent") for joint in joints} - links - {""}
    on_it = [joint for joint in joints if end_of(joint, "parent") in lost]
    if len(lost) == 1 and all(joint.get("type") == "fixed" for joint in on_it):
        base = lost.pop()
        root.insert(0, ET.Element("link", name=base))
        yield f"link {base} is not stated; it is taken as the ground"


def _on_the_ground(root: ET.Element) -> Iterator[str]:
    """Fix joints that float or move in a plane, as arms stand on a fixed base, and balls."""
    free = [joint for joint in root.findall("joint") if joint.get("type") in _FREE]
    for joint in free:
        joint.set("type", "fixed")
    if free:
        names = shortened([str(joint.get("name")) for joint in free])
        yield f"the base is taken to stand still: {names} would let it float"
    balls = [joint for joint in root.findall("joint") if joint.get("type") in _BALLS]
    for joint in balls:
        joint.set("type", "fixed")
    if balls:
        names = shortened([str(joint.get("name")) for joint in balls])
        yield f"locked at 0, since they turn about no one axis: {names}"


def _with_plain_joints(root: ET.Element) -> Iterator[str]:
    """Take out motion of joints that have none, and limits that are none."""
    none: list[str] = []
    for joint in root.findall("joint"):
        if joint.get("type") not in _MOVABLE:
            for tag in _OF_MOTION:
                for element in joint.findall(tag):
                    joint.remove(element)
            continue
        limit = joint.find("limit")
        if limit is None:
            if joint.get("type") == "continuous":
                continue
            limit = ET.SubElement(joint, "limit")
        for most in _MOST:
            if _is_none(limit.get(most, "0")):
                none.append(f"{most}={limit.get(most)} of joint {joint.get('name')}")
                limit.set(most, "0")
            limit.attrib.setdefault(most, "0")
    if none:
        yield f"no limit is taken where it is below 0 or infinite: {shortened(none)}"


def _without_negative_friction(root: ET.Element) -> Iterator[str]:
    """Take out friction below 0, as fits without bounds write it."""
    none = [
        f"{name}={own.attrib.pop(name)} of joint {joint.get('name')}"
        for joint in root.findall("joint")
        for own in joint.findall("dynamics")
        for name in ("friction", "damping")
        if _is_none(own.get(name, "0"))
    ]
    if none:
        yield f"no friction is taken where it is below 0: {shortened(none)}"


def _is_none(text: str) -> bool:
    try:
        return float(text) < 0.0 or text.strip().lower().lstrip("+") in {"inf", "infinity"}
    except ValueError:
        return False


def with_plain_numbers(root: ET.Element) -> None:
    """Write numbers as every parser reads them: one with a line break after it would be lost.

    Args:
        root: Outermost element of a URDF that is checked.
    """
    for kind, parts in NUMBERS.items():
        for element in (e for part in parts for e in root.findall(f"{kind}/{part}")):
            for name, text in element.attrib.items():
                if name not in TEXTS:
                    words = text.split() if name in VECTORS else [text]
                    element.set(name, " ".join(map(plain, words)))


def plain(word: str) -> str:
    """Return a number as every parser reads it."""
    return word.strip() if abs(float(word)) >= _SMALLEST else "0"


def without_ends(root: ET.Element) -> tuple[str, ...]:
    """Let joints whose ends are both at 0, or reversed, move on; return their names.

    Exporters of CAD programs leave ends so where nobody entered any, and a joint that cannot move
    would be a fixed one. One that turns becomes continuous, a slide gets room to either side.

    Args:
        root: Outermost element of a URDF that is checked; its joints are changed.
    """
    found: list[str] = []
    for joint in root.findall("joint"):
        limit, kind = joint.find("limit"), joint.get("type")
        if limit is None or kind not in ("revolute", "prismatic"):
            continue
        low, high = (float(limit.get(end, "0")) for end in ("lower", "upper"))
        if low <= high and (low or high):
            continue
        found.append(str(joint.get("name")))
        if kind == "revolute":
            joint.set("type", "continuous")
            for end in ("lower", "upper"):
                limit.attrib.pop(end, None)
        else:
            limit.set("lower", repr(-ROOM))
            limit.set("upper", repr(ROOM))
    return tuple(found)


def _without_odd_shapes(root: ET.Element) -> Iterator[str]:
    """Take out shapes that are none of a URDF, which its parser would drop."""
    lost: list[str] = []
    for link in root.findall("link"):
        for kind in ("visual", "collision"):
            for shape in link.findall(kind):
                if _is_shape(shape.find("geometry")):
                    continue
                link.remove(shape)
                if kind == "collision":
                    lost.append(str(link.get("name")))
    if not lost:
        return
    many = "a collision shape" if len(lost) == 1 else f"{len(lost)} collision shapes"
    named, known = shortened(list(dict.fromkeys(lost))), ", ".join(_NEEDED)
    yield (
        f"not represented: {many} of {named}, none of {known} with a size: motion is planned "
        "without"
    )


def _is_shape(geometry: ET.Element | None) -> bool:
    """Say whether a shape is one that a URDF has, with all that it needs."""
    if geometry is None or len(geometry) == 0:
        return False
    needed = _NEEDED.get(geometry[0].tag)
    scaled = len(geometry[0].get("scale", "1 1 1").split()) == _AXES
    return scaled and needed is not None and all(geometry[0].get(x) is not None for x in needed)


def unranged_notes(names: Sequence[str], slides: Sequence[str]) -> tuple[str, ...]:
    """Say which of the joints that move state no range, and what is taken for it.

    Args:
        names: Joints of `without_ends` that move.
        slides: Those of them that slide.
    """
    turn = [name for name in names if name not in slides]
    taken = (
        (turn, "turn without end"),
        (slides, f"have {ROOM:g} m to either side"),
    )
    return tuple(
        f"the limits of {shortened(of)} are 0 to 0 or reversed, so none are stated: taken to "
        f"{what}; {_REFUSED}"
        for of, what in taken
        if of
    )
