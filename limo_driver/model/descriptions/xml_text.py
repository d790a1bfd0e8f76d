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
from limo_driver.runtime.given_files import read_bytes, text_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

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
    return _without_namespace(root)


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
