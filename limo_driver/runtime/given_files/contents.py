"""Whole contents of files, as bytes, text or JSON: read once, and no more than such files have."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any, Final

from limo_driver.runtime.given_files.door import check_kind

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from limo_driver.errors import PlacedError, RecordingError

LARGEST: Final = 1 << 26  # bytes of what is read at once, if nothing else is said
_VALUES: Final = 1 << 24  # of JSON: Python makes about 100 bytes of each


def read_bytes(path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST) -> bytes:
    """Return the content of a file.

    What is opened is what is judged: nothing can take its place in between.

    Args:
        path: The file.
        error: Raised for every reason not to read it.
        most: Bytes that such a file has.

    Raises:
        error: It cannot be read, is no file, or larger.
    """
    try:
        with open(path, "rb", opener=_at_once) as file:
            check_kind(os.fstat(file.fileno()), path, error, most)
            return file.read(most + 1)
    except OSError as failure:
        raise error(f"cannot be read: {failure.strerror}", path=path) from None


def read_text(path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST) -> str:
    """Return the text of a file in UTF-8, with or without a mark at its beginning.

    Raises:
        error: It cannot be read, is no text, or larger than `most` [bytes].
    """
    return text_of(read_bytes(path, error, most), path, error)


def text_of(data: bytes, path: Path, error: type[PlacedError | RecordingError]) -> str:
    """Return bytes of a file as text.

    Raises:
        error: They are none of UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise error("is no text of UTF-8", path=path) from None


def read_json_file(
    path: Path, error: type[PlacedError | RecordingError], most: int = LARGEST
) -> Any:  # noqa: ANN401  # any JSON
    """Return what a JSON file holds.

    Raises:
        error: It cannot be read, is no JSON, or too large or too deep.
    """
    return json_of(read_text(path, error, most), path, error)


def json_of(
    text: str,
    path: Path,
    error: type[PlacedError | RecordingError],
    parse: Callable[[str], Any] = json.loads,
) -> Any:  # noqa: ANN401  # any JSON
    """Return what a text of JSON says.

    Args:
        text: The text.
        path: The file that it is from.
        error: Raised for every reason not to take it.
        parse: What makes values of it.

    Raises:
        error: It is no JSON, or has more values, levels or digits than data have.
    """
    if (values := sum(map(text.count, ",[{"))) > _VALUES:
        raise error(f"has {values} values of JSON, expected at most {_VALUES}", path=path)
    try:
        return parse(text)
    except json.JSONDecodeError as failure:
        raise error(
            f"is no JSON at line {failure.lineno}: {failure.msg}; was it cut off?", path=path
        ) from None
    except RecursionError:
        raise error("is no JSON: it is nested far deeper than a log", path=path) from None
    except ValueError:
        raise error("is no JSON: a number has thousands of digits", path=path) from None


def _at_once(path: str, flags: int) -> int:
    """Open without waiting, as a pipe to which nobody writes would have to."""
    return os.open(path, flags | os.O_NONBLOCK)
