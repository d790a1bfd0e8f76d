"""XmlText: an XML file of which single attributes change, and nothing else does.

Parsers that write what they read lose quotes, line breaks within tags and the order of attributes;
here the text stays, and edits are cut into it.

Files that an MJCF file names, meshes and textures: where they lie, and where in a copy of it.

What lies in the folder of the file keeps its place. Folders beside it, as `meshdir="../assets"`
names one, stand in the folder of the copy, and the copy says so. Absolute paths stay as they are.
Nothing farther away is copied: what a file of a stranger names there is none of its model.

Simulations in the files of other simulators: which file each target is an edit of.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

from limo_driver.errors import ConfigError
from limo_driver.quoting import in_xml
from limo_driver.runtime.installed_mujoco import mujoco

_ATTRIBUTE = re.compile(rb"(\s+)([\w:.\-]+)\s*=\s*(\"[^\"]*\"|'[^']*')")
_NAME = re.compile(rb"<[\w:.\-]+")
_ROUNDING = 1e-9  # relative


@dataclass
class Element:
    """One element and where it stands in the bytes of the file."""

    tag: str
    attributes: dict[str, str]
    start: int  # of the start tag
    head_end: int  # after the last attribute
    stop: int  # after the start tag
    is_empty: bool  # <tag/>
    end: int = 0  # where its end tag starts; after the start tag, if it is empty
    children: list[Element] = field(default_factory=list)
    parent: Element | None = field(default=None, repr=False)

    def child(self, tag: str) -> Element | None:
        """Return the first child of a tag."""
        return next((item for item in self.children if item.tag == tag), None)

    def walk(self) -> Iterator[Element]:
        """Yield the element and all in it, in order of the text."""
        yield self
        for child in self.children:
            yield from child.walk()


def as_list(*values: float) -> str:
    """Return numbers as they stand in an attribute, one after the other."""
    return " ".join(f"{float(value):.10g}" for value in values)


def differ(first: float, second: float) -> bool:
    """Say whether numbers are further apart than rounding makes them."""
    return abs(first - second) > _ROUNDING * max(abs(first), abs(second))


class XmlText:
    """The text of an XML file, and edits to it.

    Args:
        path: The file, which stays as it is.

    Raises:
        ConfigError: It is no XML, or not in UTF-8.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = path.read_bytes()
        try:
            self.data.decode("utf-8")
        except UnicodeDecodeError:
            raise ConfigError(
                "is no text of UTF-8; save it as such, and it can be changed", path=path
            ) from None
        self.root = self._parse()
        self._edits: list[tuple[int, int, bytes]] = []  # start, stop, in place of it

    def find(self, tag: str, name: str) -> Element | None:
        """Return the element of a tag with a name, if there is one."""
        return next(
            (x for x in self.root.walk() if x.tag == tag and x.attributes.get("name") == name), None
        )

    def set(self, element: Element, name: str, value: str) -> None:
        """Set an attribute, which stays where it is if it is there."""
        if element.attributes.get(name) == value:
            return
        new = in_xml(value).encode()
        spans = self._spans(element)
        if name in spans:
            before, start, stop = spans[name]
            self._forget(before, stop)
            self._edits.append((start, stop, b'"' + new + b'"'))
        else:
            self._edits.append(
                (element.head_end, element.head_end, b" " + name.encode() + b'="' + new + b'"')
            )

    def remove(self, element: Element, *names: str) -> None:
        """Remove attributes, if they are there."""
        spans = self._spans(element)
        for name in names:
            if name in spans:
                start, _, stop = spans[name]
                self._forget(start, stop)
                self._edits.append((start, stop, b""))

    def _forget(self, start: int, stop: int) -> None:
        """Take back what was done to an attribute, which is edited once more."""
        self._edits = [x for x in self._edits if not (start <= x[0] < x[1] <= stop)]

    def cut(self, start: int, stop: int, new: str = "") -> None:
        """Put something in place of some bytes of the file."""
        self._edits.append((start, stop, new.encode()))

    def drop(self, element: Element) -> None:
        """Remove an element with all in it, and the line break before it where it begins a line."""
        stop = element.stop
        if not element.is_empty:
            stop = self.data.index(b">", element.end) + 1
        start = len(self.data[: element.start].rstrip(b" \t"))
        begins = self.data[:start].endswith(b"\n")
        self.cut(start - 1 if begins else element.start, stop)

    def insert(self, element: Element, text: str) -> None:
        """Insert a line as the first content of an element, indented as its other content is."""
        indent = self._indent(element)
        if element.is_empty:
            close = f">{indent}  {text}{indent}</{element.tag}>".encode()
            self._edits.append((element.head_end, element.stop, close))
        else:
            self._edits.append((element.stop, element.stop, f"{indent}  {text}".encode()))

    def insert_after(self, element: Element, text: str) -> None:
        """Insert a line behind an element, indented as it is."""
        at = element.stop
        if not element.is_empty:
            at = self.data.index(b">", element.end) + 1
        self.cut(at, at, f"{self._indent(element)}{text}")

    def append(self, element: Element, text: str) -> None:
        """Insert a line as the last content of an element that is not empty."""
        indent = self._indent(element)
        self._edits.append((element.end, element.end, f"  {text}{indent}".encode()))

    def text(self) -> str:
        """Return the text with all edits."""
        data = self.data
        # those at one place in the order in which they were made; the last places first
        ordered = sorted(enumerate(self._edits), key=lambda item: (item[1][0], item[0]))
        for _, (start, stop, new) in reversed(ordered):
            data = data[:start] + new + data[stop:]
        return data.decode("utf-8")

    def _indent(self, element: Element) -> str:
        before = self.data[: element.start]
        line = before[before.rfind(b"\n") + 1 :]
        return "\n" + (line.decode() if not line.strip() else "")

    def _spans(self, element: Element) -> dict[str, tuple[int, int, int]]:
        """Return, of each attribute, where it starts, its value starts, and it stops."""
        found: dict[str, tuple[int, int, int]] = {}
        for match in _ATTRIBUTE.finditer(self.data, element.start, element.head_end):
            found[match[2].decode()] = (match.start(), match.start(3), match.end())
        return found

    def _parse(self) -> Element:
        parser = expat.ParserCreate()
        stack: list[Element] = []
        roots: list[Element] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            at = parser.CurrentByteIndex
            head = _NAME.match(self.data, at)
            end = at if head is None else head.end()
            while match := _ATTRIBUTE.match(self.data, end):
                end = match.end()
            stop = self.data.index(b">", end) + 1
            empty = self.data[stop - 2 : stop] == b"/>"
            element = Element(tag, attributes, at, end, stop, empty)
            if stack:
                element.parent = stack[-1]
                stack[-1].children.append(element)
            else:
                roots.append(element)
            stack.append(element)

        parser.StartElementHandler = start

        def end(_: str) -> None:
            stack.pop().end = parser.CurrentByteIndex

        parser.EndElementHandler = end
        try:
            parser.Parse(self.data, True)
        except expat.ExpatError as error:
            raise ConfigError(f"is no XML: {error}", path=self.path) from None
        return roots[0]


# MuJoCo ships no stubs.
# pyright: reportUnknownParameterType=false, reportAttributeAccessIssue=false


_FOLDERS: Final = ("meshdir", "texturedir", "assetdir")
_UP: Final = 2  # folders above that of the file, below which its assets may lie


@dataclass(frozen=True)
class Asset:
    """A file, and where it stands in the folder of a copy."""

    file: Path
    place: Path  # relative


def assets_of(into: Path) -> list[Asset]:
    """Return the files that an MJCF file names by relative paths, as far as they are there.

    Args:
        into: The file.

    Raises:
        ConfigError: One lies elsewhere than in its folder or in one of those beside it.
    """
    folder = into.resolve().parent
    found: dict[Path, Asset] = {}
    for stated, name in _named(mujoco.MjSpec.from_file(str(into))):
        if Path(stated).is_absolute() or Path(name).is_absolute():
            continue
        base = (folder / stated).resolve()
        file = (base / name).resolve()
        if not file.is_file():
            continue
        if file.is_relative_to(folder):
            place = file.relative_to(folder)
        elif file.is_relative_to(base) and base.is_relative_to(folder.parents[_UP - 1]):
            place = Path(_in_copy(stated, folder)) / file.relative_to(base)
        else:
            raise ConfigError(
                f"names {Path(stated) / name}, which is {file}; expected it in the folder of the "
                f"file, or in a meshdir below {folder.parents[_UP - 1]}: copy it there",
                path=into,
            )
        found.setdefault(file, Asset(file, place))
    return list(found.values())


def write_folders(texts: Sequence[XmlText], into: Path) -> None:
    """Write where the copy has the folders that lie beside that of the file.

    Args:
        texts: Of the file and its includes.
        into: The file.
    """
    folder = into.resolve().parent
    for text in texts:
        for element in text.root.walk():
            if element.tag != "compiler":
                continue
            for attribute in _FOLDERS:
                stated = element.attributes.get(attribute, "")
                is_beside = not (folder / stated).resolve().is_relative_to(folder)
                if is_beside and not Path(stated).is_absolute():
                    text.set(element, attribute, _in_copy(stated, folder))


def _named(spec: Any) -> Iterator[tuple[str, str]]:  # noqa: ANN401
    """Yield the folder and the name of every file."""
    for items, folder in (
        (spec.meshes, spec.meshdir),
        (spec.textures, spec.texturedir),
        (spec.hfields, spec.meshdir),
        (spec.skins, spec.meshdir),
    ):
        for item in items:
            for name in (item.file, *getattr(item, "cubefiles", ())):
                if name:
                    yield str(folder or ""), str(name)


def _in_copy(stated: str, folder: Path) -> str:
    """Return the folder of a copy that stands for one beside the file's."""
    name = (folder / stated).resolve().name
    return f"{name}_beside" if (folder / name).exists() else name


MJCF: Final = "mjcf"
URDF: Final = "urdf"
DRAKE: Final = "drake"  # a URDF with the tags of Drake, which knows no dry friction
ISAAC_LAB: Final = "isaaclab"  # a URDF, and actuators in Python beside it
USD: Final = "usd"  # a layer over the user's file, with the attributes of PhysX and of Newton
KINDS: Final = (MJCF, URDF, DRAKE, ISAAC_LAB, USD)

WITH_FRICTION: Final = (MJCF, URDF, ISAAC_LAB, USD)
WITH_ARMATURE: Final = (MJCF, DRAKE, ISAAC_LAB, USD)


def edited_format(kind: str) -> str:
    """Return the format of the file that a target is an edit of, `mjcf`, `urdf` or `usd`."""
    return kind if kind in {MJCF, USD} else URDF
