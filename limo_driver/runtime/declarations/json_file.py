"""JSON files: values as they are, each named by the way to it."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from limo_driver.runtime.declarations.given import Given
from limo_driver.runtime.given_files import json_of, read_text, text_of
from limo_driver.runtime.parameters import shown

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from limo_driver.errors import PlacedError


_DEEPEST: Final = 64  # levels; files of limo have five


class JsonGiven(Given):
    """What stands at a place of a JSON file; `content` is a value."""

    mapping = "an object"

    @property
    def is_empty(self) -> bool:
        """Whether nothing is given."""
        return self.content is None

    @cached_property
    def entries(self) -> Mapping[str, Given]:
        """The entries of an object, by name; refuses what is none."""
        if not isinstance(self.content, dict):
            self.refuse(self.mapping)
        return {name: self._inner(value, name) for name, value in self.content.items()}

    @cached_property
    def items(self) -> Sequence[Given] | None:
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

    def _inner(self, value: Any, called: str) -> JsonGiven:  # noqa: ANN401  # from JSON
        return JsonGiven(value, self.path, self.error, self, called)


def read_json(
    path: Path, error: type[PlacedError], schema: int, data: bytes | None = None
) -> JsonGiven:
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
    if not isinstance(content, dict) or content.get("schema") != schema:
        raise error(f"its schema is not {schema}", path=path)
    return JsonGiven(content, path, error)


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
