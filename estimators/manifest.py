"""The manifest of a model folder: JSON, of which every value is checked as it is taken."""

from __future__ import annotations

import json
from hashlib import sha256
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ModelStoreError
from limo_driver.runtime.declarations import read_json

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from limo_driver.runtime.declarations import JsonGiven

SCHEMA: Final = 1
MANIFEST: Final = "manifest.json"
_DIGEST: Final = "sha256"  # of all the other entries


def read_manifest(folder: Path) -> JsonGiven:
    """Read the manifest of a folder.

    Raises:
        ModelStoreError: There is none that can be read, or it was changed since it was written.
    """
    path = folder / MANIFEST
    if not folder.is_dir():
        raise ModelStoreError(f"{folder}: no such model folder")
    given = read_json(path, ModelStoreError, SCHEMA)
    own = given.content.pop(_DIGEST, None)
    if own is not None and own != _digest(given.content):  # the first manifests had none
        given.fail("was changed since it was written (sha256 differs); train the model again")
    return given


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
