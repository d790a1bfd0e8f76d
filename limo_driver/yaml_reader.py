"""Read a YAML file node by node, so that every mistake is reported at its line.

Numbers may be written in any form that Python's `float` takes: YAML 1.1 itself would read `1e-5`
(no dot) as a text.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NoReturn

import yaml

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class YamlReader:
    """Walks the YAML nodes of one file; a subclass knows what they mean.

    Args:
        path: The file.

    Raises:
        ConfigError: No file, or no YAML.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self.root = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except OSError as error:
            raise ConfigError(f"cannot be read: {error.strerror}", path=path) from None
        except UnicodeDecodeError:
            raise ConfigError("is no text file", path=path) from None
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else None
            raise ConfigError(f"is no YAML: {error.problem}", path=path, line=line) from None
        except (yaml.YAMLError, RecursionError):
            raise ConfigError(
                "is no YAML: control characters, or nested too deep", path=path
            ) from None

    def _mapping(
        self, node: yaml.Node, what: str, known: Iterable[str] | None
    ) -> dict[str, yaml.Node]:
        if not isinstance(node, yaml.MappingNode):
            self._fail(node, f"{what} has to be a mapping of `key: value`")
        entries: dict[str, yaml.Node] = {}
        names = None if known is None else tuple(known)
        for key, value in node.value:
            name = self._text(key)
            if names is not None and name not in names:
                self._fail(key, f"{what} has no {name!r}; it has {', '.join(names)}")
            if name in entries:
                self._fail(key, f"{what} has {name!r} twice")
            entries[name] = value
        return entries

    def _optional(
        self, node: yaml.Node | None, what: str, known: Iterable[str] | None
    ) -> dict[str, yaml.Node]:
        return {} if node is None or is_null(node) else self._mapping(node, what, known)

    def _numbers(self, node: yaml.Node) -> list[float]:
        nodes = node.value if isinstance(node, yaml.SequenceNode) else [node]
        return [self._number(item) for item in nodes]

    def _text(self, node: yaml.Node) -> str:
        if not isinstance(node, yaml.ScalarNode):
            kind = "list" if isinstance(node, yaml.SequenceNode) else "mapping"
            self._fail(node, f"has a {kind} where one word is expected")
        return str(node.value)

    def _number(self, node: yaml.Node) -> float:
        text = self._text(node)
        try:
            number = float(text)
        except ValueError:
            self._fail(node, f"{text!r} is no number")
        if not math.isfinite(number):
            self._fail(node, f"{text} is not finite")
        return number

    def _whole(self, node: yaml.Node) -> int:
        """Read a whole number, also a hexadecimal one (0x2031)."""
        text = self._text(node)
        try:
            return int(text, 0)
        except ValueError:
            self._fail(node, f"{text!r} is no whole number")

    def _flag(self, node: yaml.Node) -> bool:
        text = self._text(node)
        if text not in {"true", "false"}:
            self._fail(node, f"{text!r} is neither true nor false")
        return text == "true"

    def _fail(self, node: yaml.Node, message: str) -> NoReturn:
        raise ConfigError(message, path=self.path, line=node.start_mark.line + 1)


def is_null(node: yaml.Node) -> bool:
    """Say whether a node was left empty."""
    return node.tag == "tag:yaml.org,2002:null"
