"""The files that an MJCF file is made of: where they may lie, and the numbers in them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.errors import ConfigError
from limo_driver.model.descriptions.xml_text import read_xml

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path
    from xml.etree import ElementTree as ET

_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
_ASSETS: Final = ("mesh", "texture", "hfield", "skin")
_MULTIPLYING: Final = frozenset({"replicate", "composite", "flexcomp", "attach", "model", "plugin"})
_COUNT: Final = re.compile(r"\+?(?P<number>\d+(\.0*)?([eE]\+?\d+)?)(?P<unit>[KMGTPE]?)")
_MANY: Final = 10_000.0  # rows, times as many columns, are some hundred MB
_FEW: Final = 8  # words that say sizes; more are points of a mesh
# By element: a mass that is no number, MuJoCo replaces by one of a density, and hands others on.
_FINITE: Final = {
    "inertial": ("mass", "pos", "quat", "diaginertia", "fullinertia"),
    "geom": ("mass", "density"),
    "joint": ("damping", "armature", "frictionloss", "stiffness", "springref"),
}


def check_includes(path: Path) -> tuple[Path, ...]:
    """Return the files that an MJCF file is made of, itself first.

    Raises:
        ConfigError: One lies outside the folder of the first, or declares entities.
    """
    folder = path.resolve().parent
    found, waiting = [path], [(path, folder)]
    while waiting:
        current, beside = waiting.pop()
        root = read_xml(current)
        for element in (*root.iter("include"), *root.iter("model")):
            if (name := element.get("file")) is None:
                continue
            file = beside / name
            if not file.resolve().is_relative_to(folder):
                raise ConfigError(f"includes {name}, which is outside its folder", path=current)
            if not file.is_file():
                raise ConfigError(f"includes {name}, which is not there", path=path)
            if file not in found:
                found.append(file)
                waiting.append((file, beside if element.tag == "include" else file.parent))
    return tuple(found)


def check_numbers(files: Iterable[Path]) -> None:
    """Refuse masses, inertias and physics of joints that are not finite, by the element's name."""
    for path in files:
        for parent in read_xml(path).iter():
            for element in parent:
                for key in _FINITE.get(element.tag, ()):
                    _check_finite(element, key, parent, path)


def check_assets(files: Sequence[Path]) -> None:
    """Refuse meshes and textures that are devices, pipes or the like: nobody's end is in sight.

    Args:
        files: That an MJCF file is made of, itself first.

    Raises:
        ConfigError: One is.
    """
    folder = files[0].resolve().parent
    elements = [(path, element) for path in files for element in read_xml(path).iter()]
    stated = {e.get(key, "") for _, e in elements if e.tag == "compiler" for key in _FOLDERS}
    for path, element in elements:
        if element.tag not in _ASSETS or not (name := element.get("file")):
            continue
        for base in {"", *stated}:
            file = folder / base / name
            if file.exists() and not file.is_file():
                raise ConfigError(f"names {name} as a {element.tag}, which is no file", path=path)


def is_plain(files: Iterable[Path]) -> bool:
    """Say whether MuJoCo makes no more of files than stands in them.

    Copies, grids, models in models and large sizes may be anything, and take any time.
    """
    elements = [element for path in files for element in read_xml(path).iter()]
    return not any(
        element.tag in _MULTIPLYING
        or any(map(_is_large, (w for text in element.attrib.values() for w in text.split()[:_FEW])))
        for element in elements
    )


def _is_large(word: str) -> bool:
    """Say whether a word is a number of so many that it could be too many."""
    found = _COUNT.fullmatch(word)
    return found is not None and (bool(found["unit"]) or float(found["number"]) >= _MANY)


def _check_finite(element: ET.Element, key: str, parent: ET.Element, path: Path) -> None:
    for word in element.get(key, "").split():
        try:
            value = float(word)
        except ValueError:
            continue  # MuJoCo says so
        if not np.isfinite(value):
            place = " ".join(filter(None, (parent.tag, parent.get("name") or parent.get("class"))))
            raise ConfigError(
                f"{place}: {key} of its {element.tag} is {word}, expected a finite number",
                path=path,
            )
