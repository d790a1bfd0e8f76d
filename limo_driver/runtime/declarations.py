"""Read what files declare, YAML or JSON, so that every mistake is reported at its place.

A message says the file, the line (of YAML), the way to the entry, what was given, what was expected
and what exists.

YAML files: nodes as they stand, so that every mistake is reported at its line.

Numbers may be written in any form that Python's `float` takes: YAML 1.1 itself would read `1e-5`
(no dot) as a text.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import yaml

from limo_driver.errors import ConfigError, PlacedError
from limo_driver.runtime import written_by
from limo_driver.runtime.given import ConfigNode
from limo_driver.runtime.given_files import json_of, read_text, text_of
from limo_driver.runtime.parameters import FLAG, REAL, TEXT, WHOLE, shown

__all__ = ["ConfigNode", "JsonNode", "YamlNode", "read_json", "read_yaml"]
_LARGEST_YAML = 1 << 18  # bytes; ten times the largest that anybody wrote
_NULL = "tag:yaml.org,2002:null"
_DEEPEST: Final = 64  # levels; files of limo have five


class YamlNode(ConfigNode):
    """What stands at a place of a YAML file; `content` is a node, or None in an empty file."""

    mapping = "a mapping"

    @property
    def is_empty(self) -> bool:
        """Whether nothing is given."""
        return self.content is None or self.content.tag == _NULL

    @cached_property
    def entries(self) -> Mapping[str, ConfigNode]:
        """The entries of a mapping, by name; refuses what is none."""
        if self.is_empty:
            return {}
        if not isinstance(self.content, yaml.MappingNode):
            self.refuse(f"{self.mapping} of `key: value`")
        found: dict[str, ConfigNode] = {}
        for key, node in self.content.value:
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                self.fail(f"has {_said(key)} as a name, expected a text", line)
            if key.value in found:
                self.fail(f"has {key.value!r} twice", line)
            found[key.value] = self._inner(node, key.value, line)
        return found

    @cached_property
    def items(self) -> Sequence[ConfigNode] | None:
        """The items of a list; none if it is left empty, and a value alone is a list of one."""
        if self.is_empty:
            return []
        if isinstance(self.content, yaml.ScalarNode):
            return [self]
        if not isinstance(self.content, yaml.SequenceNode):
            return None
        return [
            self._inner(node, f"number {i}", node.start_mark.line + 1)
            for i, node in enumerate(self.content.value, start=1)
        ]

    def scalar(self, kind: str) -> Any:  # noqa: ANN401  # of that kind, if it can be
        """Return one value; its text, where that is not of the kind."""
        if not isinstance(self.content, yaml.ScalarNode):
            self.refuse(kind)
        text = str(self.content.value)
        try:
            if kind == REAL:
                return float(text)
            if kind == WHOLE:
                return _whole(text)
        except (ValueError, OverflowError):
            return text
        return text == "true" if kind == FLAG and text in {"true", "false"} else text

    def plain(self) -> Any:  # noqa: ANN401  # of any type that YAML knows
        """Return one value of the type that YAML itself takes it for."""
        self.scalar(TEXT)
        try:
            return yaml.SafeLoader("").construct_object(self.content)
        except (yaml.YAMLError, ValueError, KeyError, AttributeError):  # as PyYAML has it
            self.refuse("a text, a number, a date or true or false")

    @property
    def said(self) -> str:
        """What is given, for messages."""
        return "nothing" if self.content is None else _said(self.content)

    def _inner(self, node: yaml.Node, called: str, line: int) -> YamlNode:
        inner = YamlNode(node, self.path, self.error, self, called)
        inner.line = line
        return inner


def read_yaml(path: Path, needs: str = "") -> YamlNode:
    """Read a YAML file.

    Args:
        path: The file.
        needs: What it cannot be without; an empty file is refused with it.

    Raises:
        ConfigError: No file, no YAML, or empty; so does all that is taken from it, if it is wrong.
    """
    text = read_text(path, ConfigError, _LARGEST_YAML)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise ConfigError(f"is no YAML: {error.problem}", path=path, line=line) from None
    except (yaml.YAMLError, RecursionError):
        raise ConfigError("is no YAML: control characters, or nested too deep", path=path) from None
    if root is None and needs:
        raise ConfigError(f"is empty; it needs {needs}", path=path)
    given = YamlNode(root, path)
    given.line = None if root is None else root.start_mark.line + 1
    if isinstance(root, yaml.MappingNode):
        named = {key.value: value.value for key, value in root.value if key.id == "scalar"}
        given.writer = written_by.writer_of(named)
    return given


def _whole(text: str) -> int | str:
    """Read a whole number, also a hexadecimal one (0x2031)."""
    try:
        return int(text, 0)
    except ValueError:
        number = float(text)
        return int(number) if number.is_integer() else text


def _said(node: yaml.Node) -> str:
    if isinstance(node, yaml.ScalarNode):
        return repr(node.value)
    return "a list" if isinstance(node, yaml.SequenceNode) else "a mapping"


class JsonNode(ConfigNode):
    """What stands at a place of a JSON file; `content` is a value."""

    mapping = "an object"

    @property
    def is_empty(self) -> bool:
        """Whether nothing is given."""
        return self.content is None

    @cached_property
    def entries(self) -> Mapping[str, ConfigNode]:
        """The entries of an object, by name; refuses what is none."""
        if not isinstance(self.content, dict):
            self.refuse(self.mapping)
        return {name: self._inner(value, name) for name, value in self.content.items()}

    @cached_property
    def items(self) -> Sequence[ConfigNode] | None:
        """The items of a list; None if it is none."""
        if not isinstance(self.content, list):
            return None
        return [self._inner(value, f"number {i}") for i, value in enumerate(self.content, start=1)]

    def scalar(self, kind: str) -> Any:  # noqa: ANN401, ARG002  # JSON has types
        """Return one value as it is given."""
        return self.content

    def plain(self) -> Any:  # noqa: ANN401  # of any type that JSON knows
        """Return what is given."""
        return self.content

    @property
    def said(self) -> str:
        """What is given, for messages."""
        return shown(self.content)

    def _inner(self, value: Any, called: str) -> JsonNode:  # noqa: ANN401  # from JSON
        return JsonNode(value, self.path, self.error, self, called)


def read_json(
    path: Path, error: type[PlacedError], schema: int, data: bytes | None = None
) -> JsonNode:
    """Read a JSON file, an object of a schema.

    Args:
        path: The file.
        error: Raised for every mistake, here and later.
        schema: Number that its entry `schema` has to be.
        data: What stands in it, if that was read already.

    Raises:
        error: No file, no JSON, or of another schema.
    """
    text = read_text(path, error) if data is None else text_of(data, path, error)
    content: Any = json_of(text, path, error)
    if not _is_shallow(content):
        raise error(f"is nested more than {_DEEPEST} levels deep", path=path)
    given = JsonNode(content, path, error)
    given.writer = written_by.writer_of(content)
    if not isinstance(content, dict) or content.get("schema") != schema:
        given.fail(f"its schema is not {schema}")
    return given


def _is_shallow(content: object) -> bool:
    """Say whether content is nested no deeper than files of limo are; deeper, printing it fails."""
    level = [content]
    for _ in range(_DEEPEST):
        level = [
            inner
            for outer in level
            if isinstance(outer, (dict, list))
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
        if not level:
            return True
    return False
