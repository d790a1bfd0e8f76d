"""Files that a user gives: read only if they are files, and no larger than such files are."""

from __future__ import annotations

import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    from limo_driver.errors import PlacedError, RecordingError


def check_file(
    path: Path, error: type[PlacedError | RecordingError], most: int | None = None
) -> None:
    """Refuse what would be read for ever, or waited for: a device or a pipe, also behind a link.

    What is not there, or may not be read, is left to whoever opens it.

    Args:
        path: Of the file, or a folder.
        error: Raised for it.
        most: Size of the largest such file [bytes].

    Raises:
        error: A device, a pipe, or too large.
    """
    try:
        about = path.stat()
    except OSError:
        return
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        raise error("is a device or a pipe, expected a file", path=path)
    if most is not None and about.st_size > most:
        raise error(
            f"has {about.st_size} bytes, expected at most {most}: is another file meant?", path=path
        )
