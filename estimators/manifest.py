"""The manifest of a model folder: JSON, of which every value is checked as it is taken."""

from __future__ import annotations

import json
from dataclasses import dataclass
from hashlib import sha256
from math import inf, isfinite
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ModelStoreError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
_DIGEST: Final = "sha256"  # of all the other entries
_SHOWN: Final = 60  # characters of a value that a message repeats


@dataclass(frozen=True)
class Entries:
    """An object of a manifest, and where it stands; each method takes one of its entries.

    Raises:
        ModelStoreError: The entry is missing, of the wrong type, or cannot be; the message says
            where, what was given and what was expected.
    """

    place: str  # for example `model/manifest.json: inputs: number 3`
    values: Mapping[str, Any]

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def text(self, name: str, known: Sequence[str] = ()) -> str:
        """Return a text, one of those known if there are any."""
        value = self._take(name)
        if not isinstance(value, str) or not value:
            raise self._wrong(name, value, "a text")
        if known and value not in known:
            raise ModelStoreError(
                f"{self.place}: {name} {value!r} is unknown; known: {', '.join(known)}"
            )
        return value

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list of texts."""
        value = self._take(name)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self._wrong(name, value, "a list of texts")
        return tuple(value)

    def flag(self, name: str) -> bool:
        """Return true or false."""
        value = self._take(name)
        if not isinstance(value, bool):
            raise self._wrong(name, value, "true or false")
        return value

    def number(
        self, name: str, *, least: float = -inf, most: float = inf, above: float = -inf
    ) -> float:
        """Return a finite number within limits."""
        value = self._take(name)
        if not _is_number(value, least, most, above):
            raise self._wrong(name, value, f"a number{_limits(least, most, above)}")
        return float(value)

    def numbers(
        self, name: str, length: int | None = None, *, least: float = -inf, above: float = -inf
    ) -> tuple[float, ...]:
        """Return a list of finite numbers within limits, of a length if one is given."""
        value = self._take(name)
        if (
            not isinstance(value, list)
            or (length is not None and len(value) != length)
            or not all(_is_number(item, least, inf, above) for item in value)
        ):
            many = "" if length is None else f"{length} "
            raise self._wrong(name, value, f"a list of {many}numbers{_limits(least, inf, above)}")
        return tuple(map(float, value))

    def entries(self, name: str) -> Entries:
        """Return an object."""
        value = self._take(name)
        if not isinstance(value, dict):
            raise self._wrong(name, value, "an object")
        return Entries(f"{self.place}: {name}", value)

    def list(self, name: str) -> tuple[Entries, ...]:
        """Return a list of objects, numbered from 1."""
        value = self._take(name)
        if not isinstance(value, list) or not all(isinstance(item, dict) for item in value):
            raise self._wrong(name, value, "a list of objects")
        return tuple(
            Entries(f"{self.place}: {name}: number {i}", item) for i, item in enumerate(value, 1)
        )

    def _take(self, name: str) -> Any:  # noqa: ANN401  # from JSON
        if name not in self.values:
            raise ModelStoreError(f"{self.place}: lacks {name}")
        return self.values[name]

    def _wrong(self, name: str, value: object, expected: str) -> ModelStoreError:
        shown = repr(value)
        shown = shown if len(shown) <= _SHOWN else f"{shown[:_SHOWN]}…"
        return ModelStoreError(f"{self.place}: {name} is {shown}, expected {expected}")


def read_manifest(folder: Path) -> Entries:
    """Read the manifest of a folder.

    Raises:
        ModelStoreError: There is none that can be read, or it was changed since it was written.
    """
    path = folder / MANIFEST
    if not folder.is_dir():
        raise ModelStoreError(f"{folder}: no such model folder")
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelStoreError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ModelStoreError(f"{path}: no JSON: {error}") from None
    if not isinstance(values, dict) or values.get("schema") != SCHEMA:
        raise ModelStoreError(f"{path}: its schema is not {SCHEMA}")
    own = values.pop(_DIGEST, None)
    if own is not None and own != _digest(values):  # the first manifests had none
        raise ModelStoreError(
            f"{path}: was changed since it was written (sha256 differs); train the model again"
        )
    return Entries(str(path), values)


def as_manifest(values: Mapping[str, Any]) -> str:
    """Return the text of a manifest with these entries, and the digest by which changes show.

    Raises:
        ModelStoreError: A value is no JSON, or no finite number.
    """
    try:
        sealed = {"schema": SCHEMA, **values}
        sealed[_DIGEST] = _digest({k: v for k, v in sealed.items() if k != _DIGEST})
        return json.dumps(sealed, indent=1, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise ModelStoreError(f"the manifest of the model is no JSON: {error}") from None


def _digest(values: Mapping[str, Any]) -> str:
    """Return the sha256 of entries, however they are spaced and ordered."""
    return sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _is_number(value: object, least: float, most: float, above: float) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return isfinite(value) and least <= value <= most and value > above
    except OverflowError:  # an integer beyond all floats
        return False


def _limits(least: float, most: float, above: float) -> str:
    if above > -inf:
        return f" above {above:g}"
    if least > -inf and most < inf:
        return f" in {least:g} to {most:g}"
    return f" of {least:g} or more" if least > -inf else ""
