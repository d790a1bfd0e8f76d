"""What a URDF has to be before its parser sees it: a tree of links on a fixed base, all of numbers.

The parser itself says little of what is wrong, and leaves out masses that it cannot read. What
other readers overlook is put right before, with a note: an axis on a joint that does not move, a
limit of -1 for none, a base that floats, each of which means one thing alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.description import ROOM
from limo_driver.quoting import in_shell
from limo_driver.runtime.display import shortened

_MOVABLE: Final = ("revolute", "continuous", "prismatic")
_ON_A_FIXED_BASE: Final = (*_MOVABLE, "fixed")
_AXES: Final = 3
VECTORS: Final = ("xyz", "rpy", "size", "scale")  # of several numbers; all else is one
_SHAPES: Final = {  # and what each needs
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "capsule": ("radius", "length"),
    "mesh": ("filename",),
}
TEXTS: Final = ("filename", "name")
LARGEST: Final = 1e50  # of a number in any unit; its square and more can be computed
NUMBERS: Final = {
    "link": (
        *("inertial/mass", "inertial/inertia", "inertial/origin"),
        *("visual/origin", "collision/origin"),
        *(f"{of}/geometry/{shape}" for of in ("visual", "collision") for shape in _SHAPES),
    ),
    "joint": ("origin", "axis", "limit"),
}
_INERTIAL: Final = {"mass": ("value",), "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")}
_MACROS: Final = ("${", "$(")


def check_urdf(root: ET.Element, path: Path) -> None:
    """Check a URDF.

    Args:
        root: Its outermost element.
        path: The file, for messages.

    Raises:
        ConfigError: It has macros, names something twice or not at all, is no tree on a fixed base,
            or states no finite numbers; in one line.
    """
    _refuse_macros(root, path)
    for kind in ("link", "joint"):
        if any(item.get("name") is None for item in root.findall(kind)):
            raise ConfigError(f"has a {kind} without a name", path=path)
        names = [str(item.get("name")) for item in root.findall(kind)]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ConfigError(f"has more than one {kind} called {', '.join(repeated)}", path=path)
    if root.find("link") is None:
        raise ConfigError("has no <link>", path=path)
    for joint in root.findall("joint"):
        if joint.get("type") not in _ON_A_FIXED_BASE:
            raise ConfigError(
                f"joint {joint.get('name')} is of type {joint.get('type')!r}, expected one of "
                f"{', '.join(_ON_A_FIXED_BASE)}",
                path=path,
            )
    # Refuse what the parser would leave out silently, all other masses with it
    for link in root.findall("link"):
        for stated in link.findall("inertial"):
            _check_inertial(stated, f"link {link.get('name')!r}", path)
    for kind, parts in NUMBERS.items():
        for owner in root.findall(kind):
            for part in parts:
                for element in owner.findall(part):
                    _check_element(f"{kind} {owner.get('name')!r}", element, path)
    _check_ends(root, path)
    _check_tree(root, path)


def end_of(joint: ET.Element, which: str) -> str:
    """Return the link at an end of a joint, its `parent` or `child`; nothing if it has none."""
    element = joint.find(which)
    return "" if element is None else str(element.get("link"))


def _refuse_macros(root: ET.Element, path: Path) -> None:
    macros = [element.tag.rpartition("}")[2] for element in root.iter() if "xacro" in element.tag]
    for kind in ("link", "joint"):
        for part in root.findall(f"{kind}//") + root.findall(kind):
            macros += [text for text in part.attrib.values() if any(x in text for x in _MACROS)]
    if macros:
        name = path.name.split(".")[0]
        source, expanded = in_shell(Path(path.name)), in_shell(Path(f"{name}_expanded.urdf"))
        raise ConfigError(
            f"has macros ({macros[0]}): it is a xacro; expand it first, "
            f"`xacro {source} > {expanded}`",
            path=path,
        )


def _check_ends(root: ET.Element, path: Path) -> None:
    """Refuse joints between links that are not there.

    Raises:
        ConfigError: There is one.
    """
    links = {str(link.get("name")) for link in root.findall("link")}
    for joint in root.findall("joint"):
        name = joint.get("name")
        for which in ("parent", "child"):
            if (end := end_of(joint, which)) not in links:
                said = (
                    f"its {which} is the link {end!r}, which is not there"
                    if end
                    else (f"it has no {which}")
                )
                raise ConfigError(f"joint {name!r}: {said}", path=path)


def _check_inertial(stated: ET.Element, owner: str, path: Path) -> None:
    for tag, names in _INERTIAL.items():
        element = stated.find(tag)
        if element is None:
            raise ConfigError(f"{owner}: its <inertial> lacks <{tag}>", path=path)
        if lacking := [x for x in names if element.get(x) is None]:
            what = f"{', '.join(lacking)} of its {tag}"
            raise ConfigError(f"{owner}: its <inertial> lacks {what}", path=path)


def _check_tree(root: ET.Element, path: Path) -> None:
    """Refuse links that carry one another in a circle, that several joints move, or none.

    Raises:
        ConfigError: There is one; or a joint turns about no axis.
    """
    above: dict[str, tuple[str, str]] = {}  # link → joint, link that carries it
    for joint in root.findall("joint"):
        name, child = str(joint.get("name")), end_of(joint, "child")
        if child in above:
            raise ConfigError(
                f"link {child} is moved by two joints, {above[child][0]} and {name}; expected a "
                "tree",
                path=path,
            )
        above[child] = (name, end_of(joint, "parent"))
        axis = joint.find("axis")
        if axis is None or joint.get("type") not in _MOVABLE:
            continue
        if not any(map(float, axis.get("xyz", "1 0 0").split())):
            raise ConfigError(
                f"joint {name!r}: its axis is {axis.get('xyz')}, expected a direction",
                path=path,
            )
    for start in above:
        seen, link = {start}, above[start][1]
        while link in above and link not in seen:
            seen.add(link)
            link = above[link][1]
        if link in seen:
            raise ConfigError(
                f"links {shortened(sorted(seen))} carry one another in a circle; expected a tree",
                path=path,
            )
    roots = [
        str(link.get("name")) for link in root.findall("link") if link.get("name") not in above
    ]
    if len(roots) > 1:
        raise ConfigError(
            f"has {len(roots)} links that no joint carries, {shortened(roots)}; expected one, the "
            "base",
            path=path,
        )


def _check_element(owner: str, element: ET.Element, path: Path) -> None:
    for name, text in element.attrib.items():
        if name in TEXTS:
            continue
        if name in VECTORS and len(text.split()) != _AXES:
            said = text.strip() or "empty"
            raise ConfigError(
                f"{owner}: {name} of its {element.tag} is {said}, expected {_AXES} numbers",
                path=path,
            )
        for word in text.split() if name in VECTORS else [text]:
            try:
                value = float(word)
            except ValueError:
                value = np.nan
            is_number = abs(value) <= LARGEST
            if not is_number or (element.tag == "mass" and value < 0.0):
                expected = "0 or more" if element.tag == "mass" else "a finite number"
                expected += f" within {LARGEST:g}" * bool(np.isfinite(value) and not is_number)
                raise ConfigError(
                    f"{owner}: {name} of its {element.tag} is {word.strip() or 'empty'}, "
                    f"expected {expected}",
                    path=path,
                )


_LOCKED: Final = {  # kinds of joints that are taken as fixed, and what is said of them
    ("floating", "planar"): "the base is taken to stand still: {} would let it float",
    ("spherical", "ball"): "locked at 0, since they turn about no one axis: {}",  # of simulators
}
_OF_MOTION: Final = ("axis", "limit", "mimic", "dynamics", "safety_controller")
_MOST: Final = ("effort", "velocity")  # of a joint that moves
_SMALLEST: Final = 1e-300  # of a number; parsers refuse some that are smaller
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
    for kinds, text in _LOCKED.items():
        joints = [joint for joint in root.findall("joint") if joint.get("type") in kinds]
        for joint in joints:
            joint.set("type", "fixed")
        if joints:
            yield text.format(shortened([str(joint.get("name")) for joint in joints]))


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
    named, known = shortened(list(dict.fromkeys(lost))), ", ".join(_SHAPES)
    yield (
        f"not represented: {many} of {named}, none of {known} with a size: motion is planned "
        "without"
    )


def _is_shape(geometry: ET.Element | None) -> bool:
    """Say whether a shape is one that a URDF has, with all that it needs."""
    if geometry is None or len(geometry) == 0:
        return False
    needed = _SHAPES.get(geometry[0].tag)
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
