"""Files alone are let in: no device, no pipe, and nothing that is larger than such files are."""

from __future__ import annotations

import stat
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import os
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
        check_kind(path.stat(), path, error, most)
    except OSError:
        return


def check_kind(
    about: os.stat_result,
    path: Path,
    error: type[PlacedError | RecordingError],
    most: int | None = None,
) -> None:
    """Refuse by what the system says of a file, as `check_file` does.

    Raises:
        error: A device, a pipe, or too large.
    """
    if not (stat.S_ISREG(about.st_mode) or stat.S_ISDIR(about.st_mode)):
        raise error("is a device or a pipe, expected a file", path=path)
    if most is not None and about.st_size > most:
        raise error(
            f"has {about.st_size} bytes, expected at most {most}: is another file meant?", path=path
        )
