"""XML of strangers: parsed without entities, which could fill the memory or read other files."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn
from xml.etree import ElementTree as ET
from xml.parsers import expat

from limo_driver.errors import ConfigError
from limo_driver.runtime.given_files import read_text

if TYPE_CHECKING:
    from pathlib import Path

MOST_JOINTS = 1000  # elements, also of what refers to joints
_DEEPEST = 500  # levels, as MuJoCo and urdfdom read; more end what parses them one in the other
_MOST_PARTS = 1_000_000  # elements and attributes; meshes are files of their own


def read_xml(path: Path) -> ET.Element:
    """Parse a file.

    Args:
        path: The file.

    Raises:
        ConfigError: It is no XML, too large, nested too deep, or declares entities.
    """
    text = read_text(path, ConfigError)
    if (parts := text.count("<") + text.count("=")) > _MOST_PARTS:
        raise ConfigError(
            f"has {parts} elements and attributes, expected at most {_MOST_PARTS}", path=path
        )
    if (joints := text.count("<joint")) > MOST_JOINTS:
        raise ConfigError(f"has {joints} joints, expected at most {MOST_JOINTS}", path=path)
    check_nesting(text, path)
    try:
        root = ET.fromstring(text)  # noqa: S314  # no entities are left by now
    except ET.ParseError as error:
        raise ConfigError(f"is no XML: {error}", path=path) from None
    return _without_namespace(root)


def _without_namespace(root: ET.Element) -> ET.Element:
    """Name elements without the namespace of the outermost, which URDFs for Drake declare."""
    space, named, _ = root.tag.rpartition("}")
    if named:
        for element in root.iter():
            element.tag = element.tag.removeprefix(f"{space}}}")
    return root


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
