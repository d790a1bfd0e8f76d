"""Results in a folder, one folder each: a result is there in full or not at all."""

from __future__ import annotations

import json
from dataclasses import dataclass
from shutil import rmtree
from typing import TYPE_CHECKING, Any, cast

from limo_driver.errors import ConfigError
from limo_driver.runtime.outputs import sync, whole

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path


@dataclass(frozen=True)
class KeptResults:
    """Results by key: files, and a record that is written last and in one piece.

    What is finished is on the disk before it is told; so it survives the end of any process.

    Args:
        folder: Of all.
        record: Name of the file that says that a result is finished, and how it ended.
    """

    folder: Path
    record: str

    def place(self, key: str) -> Path:
        """Return the folder of a result."""
        return self.folder / key

    def keep(
        self,
        key: str,
        record: Mapping[str, Any],
        files: Mapping[str, bytes],
        last: Callable[[Path], None] = lambda _place: None,
    ) -> None:
        """Keep a result: its files, what `last` writes beside them, and the record.

        Args:
            key: Of the result; what is there of one that was not finished, goes.
            record: As JSON.
            files: By name; a name may have folders.
            last: Writes files that depend on where they lie.

        Raises:
            ConfigError: It cannot be written.
        """
        place = self.place(key)
        try:
            if place.exists():
                rmtree(place)
            place.mkdir(parents=True)
            for name in files:
                (place / name).parent.mkdir(parents=True, exist_ok=True)
        except OSError as failure:
            raise ConfigError(f"cannot be written to: {failure.strerror}", path=place) from None
        for name, content in files.items():
            with whole(place / name) as draft:
                draft.write_bytes(content)
        last(place)
        with whole(place / self.record) as draft:
            draft.write_text(json.dumps(record), encoding="utf-8")
        sync(place)

    def finished(self, key: str) -> dict[str, Any] | None:
        """Return the record of a result; None while it has none, or where that is damaged."""
        try:
            kept: object = json.loads((self.place(key) / self.record).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return cast("dict[str, Any]", kept) if isinstance(kept, dict) else None
