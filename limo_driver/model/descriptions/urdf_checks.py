"""What a URDF has to be before its parser sees it: a tree of links on a fixed base, all of numbers.

The parser itself says little of what is wrong, and leaves out masses that it cannot read.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.quoting import in_shell
from limo_driver.runtime.display import shortened

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

_MOVABLE: Final = ("revolute", "continuous", "prismatic")
_ON_A_FIXED_BASE: Final = (*_MOVABLE, "fixed")
_AXES: Final = 3
VECTORS: Final = ("xyz", "rpy", "size", "scale")  # of several numbers; all else is one
_SHAPES: Final = ("box", "cylinder", "sphere", "capsule", "mesh")
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
_INERTIAL: Final = {
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
}
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
    _check_names(root, path)
    _check_types(root, path)
    _check_numbers(root, path)
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


def _check_names(root: ET.Element, path: Path) -> None:
    for kind in ("link", "joint"):
        if any(item.get("name") is None for item in root.findall(kind)):
            raise ConfigError(f"has a {kind} without a name", path=path)
        names = [str(item.get("name")) for item in root.findall(kind)]
        if repeated := sorted({name for name in names if names.count(name) > 1}):
            raise ConfigError(f"has more than one {kind} called {', '.join(repeated)}", path=path)
    if root.find("link") is None:
        raise ConfigError("has no <link>", path=path)


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


def _check_types(root: ET.Element, path: Path) -> None:
    for joint in root.findall("joint"):
        if joint.get("type") not in _ON_A_FIXED_BASE:
            raise ConfigError(
                f"joint {joint.get('name')} is of type {joint.get('type')!r}, expected one of "
                f"{', '.join(_ON_A_FIXED_BASE)}",
                path=path,
            )


def _check_numbers(root: ET.Element, path: Path) -> None:
    """Refuse what the parser would leave out silently, all other masses with it.

    Raises:
        ConfigError: Names the link or joint, and what is no finite number.
    """
    for link in root.findall("link"):
        for stated in link.findall("inertial"):
            _check_inertial(stated, f"link {link.get('name')!r}", path)
    for kind, parts in NUMBERS.items():
        for owner in root.findall(kind):
            for part in parts:
                for element in owner.findall(part):
                    _check_element(f"{kind} {owner.get('name')!r}", element, path)


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
