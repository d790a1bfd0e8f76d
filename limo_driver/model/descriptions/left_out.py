"""What URDFs leave out and other programs make up for: the ground, ranges of joints, odd shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree as ET

from limo_driver.model.descriptions.description import ROOM
from limo_driver.model.descriptions.urdf_checks import end_of
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from collections.abc import Sequence

_GROUND: Final = "world"
_SHAPES: Final = {  # and what each needs
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "mesh": ("filename",),
}
_REFUSED: Final = "without a range, the arm cannot be planned or run"


def with_ground(root: ET.Element) -> tuple[str, ...]:
    """Add the ground that a URDF for Drake is welded to without stating it; return what to say.

    Args:
        root: Its outermost element; the link is added there.
    """
    links = {str(link.get("name")) for link in root.findall("link")}
    on_it = [joint for joint in root.findall("joint") if end_of(joint, "parent") == _GROUND]
    if _GROUND in links or not any(joint.get("type") == "fixed" for joint in on_it):
        return ()
    root.insert(0, ET.Element("link", name=_GROUND))
    return (f"link {_GROUND} is not stated; it is taken as the ground, as Drake does",)


def without_ends(root: ET.Element) -> tuple[str, ...]:
    """Let joints whose ends are both at 0 move on, as none are stated; return their names.

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
        if any(float(limit.get(end, "0")) for end in ("lower", "upper")):
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


def without_odd_shapes(root: ET.Element) -> tuple[str, ...]:
    """Take out shapes that are none of a URDF, which its parser would drop; return what to say.

    Args:
        root: Outermost element of a URDF; its links are changed.
    """
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
        return ()
    many = "a collision shape" if len(lost) == 1 else f"{len(lost)} collision shapes"
    named, known = shortened(list(dict.fromkeys(lost))), ", ".join(_SHAPES)
    return (
        f"not represented: {many} of {named}, none of {known} with a size: motion is planned "
        "without",
    )


def _is_shape(geometry: ET.Element | None) -> bool:
    """Say whether a shape is one that a URDF has, with all that it needs."""
    if geometry is None or len(geometry) == 0:
        return False
    needed = _SHAPES.get(geometry[0].tag)
    return needed is not None and all(geometry[0].get(name) is not None for name in needed)


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
        f"the limits of {shortened(of)} are 0 to 0, so none are stated: taken to {what}; {_REFUSED}"
        for of, what in taken
        if of
    )
