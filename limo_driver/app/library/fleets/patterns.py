"""Files that a pattern names, each folder visited once, however many links lead to it."""

from __future__ import annotations

import os
from glob import escape, glob
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

_ANY_DEPTH: Final = "**"


def files_of(pattern: str) -> list[Path]:
    """Return the files that match, each once, in order; a link to nothing is among them.

    `**` stands for any number of folders, linked ones included. `glob` of Python would follow a
    link to a folder above it round and round.

    Args:
        pattern: As a shell has it.
    """
    found = dict.fromkeys(sorted(_matching(pattern)))
    places = map(Path, found)
    return [place for place in places if not place.is_dir() and os.path.lexists(place)]


def _matching(pattern: str) -> Iterator[str]:
    parts = Path(pattern).parts
    if _ANY_DEPTH not in parts:
        yield from glob(pattern)
        return
    at = parts.index(_ANY_DEPTH)
    rest = Path(*(parts[at + 1 :] or ("*",)))
    for top in sorted(glob(str(Path(*parts[:at])))) if at else ["."]:
        for folder in _folders(Path(top)):
            yield from _matching(str(Path(escape(str(folder))) / rest))


def _folders(top: Path) -> Iterator[Path]:
    """Yield a folder and all below it but hidden ones, each once: by its own name before a link."""
    seen: set[str] = set()
    waiting = [top]
    while waiting:
        links: list[Path] = []
        for start in waiting:
            for name, folders, _ in os.walk(start):
                folder = Path(name)
                if (real := os.path.realpath(folder)) in seen:
                    folders.clear()
                    continue
                seen.add(real)
                yield folder
                below = [folder / each for each in sorted(folders) if not each.startswith(".")]
                links += [each for each in below if each.is_symlink()]
                folders[:] = [each.name for each in below if not each.is_symlink()]
        waiting = links
