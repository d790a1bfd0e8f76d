"""XML of strangers: parsed without entities, which could fill the memory or read other files.

The readers that descriptions are written for (tinyxml) take more than XML allows: "--" in comments,
prefixes that nobody declares, attributes without a space between them, blanks or comments before
the declaration. So does limo.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final, NoReturn
from xml.etree import ElementTree as ET
from xml.parsers import expat

from limo_driver.errors import ConfigError
from limo_driver.runtime.given_files import read_text

if TYPE_CHECKING:
    from pathlib import Path

MOST_JOINTS = 1000  # elements, also of what refers to joints
_DEEPEST = 500  # levels, as MuJoCo and urdfdom read; more end what parses them one in the other
_MOST_PARTS = 1_000_000  # elements and attributes; meshes are files of their own
_OUTERMOST: Final = re.compile(r"<[A-Za-z_][\w.:-]*")
_ATTACHED: Final = re.compile(r"""(=\s*(?:"[^"<]*"|'[^'<]*'))(?=[A-Za-z_])""")
_PREFIX: Final = re.compile(r"(?:</?|\s)([A-Za-z_][\w.-]*):[A-Za-z_]")


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
    text = _as_xml(text)
    check_nesting(text, path)
    try:
        root = ET.fromstring(text)  # noqa: S314  # no entities are left by now
    except ET.ParseError as error:
        raise ConfigError(f"is no XML: {error}", path=path) from None
    return _without_namespace(root)


def _as_xml(text: str) -> str:
    """Return a text with what its readers overlook made XML, each line where it was."""
    text = _without(text.rstrip("\0"), "<!--", "-->")
    if not text.startswith("<?xml"):
        text = _without(text, "<?xml", "?>")
    text = _ATTACHED.sub(r"\1 ", text)
    outermost = _OUTERMOST.search(text)
    if outermost is None:
        return text
    head = text[outermost.end() : text.find(">", outermost.end())]
    declared = {"xml", "xmlns", *re.findall(r"\bxmlns:([\w.-]+)", head)}
    used = dict.fromkeys(_PREFIX.findall(text))
    own = "".join(f' xmlns:{prefix}="{prefix}"' for prefix in used if prefix not in declared)
    return text[: outermost.end()] + own + text[outermost.end() :]


def _without(text: str, start: str, end: str) -> str:
    """Return a text without what stands between two marks, but with its lines."""
    kept, at = list[str](), 0
    while (first := text.find(start, at)) >= 0 <= (last := text.find(end, first + len(start))):
        kept += [text[at:first], "\n" * text.count("\n", first, last)]
        at = last + len(end)
    return "".join([*kept, text[at:]])


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
