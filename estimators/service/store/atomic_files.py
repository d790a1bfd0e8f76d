"""Files that are either there in full or not at all, also after a crash or a loss of power."""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager
from shutil import rmtree
from typing import TYPE_CHECKING, Final
from uuid import uuid4

from limo_driver.runtime.outputs import replacing, sync

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

_LOCK: Final = ".lock"
_DRAFT: Final = ".adding-"


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Be the only writer of a folder; the lock goes with the process that holds it."""
    with (folder / _LOCK).open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def draft(folder: Path) -> Generator[Path]:
    """Make a hidden folder in `folder` to write in, which is gone afterwards unless renamed.

    What writers left that were killed is removed first: each holds a lock on its own draft, so that
    one that nobody holds is of no one.
    """
    with locked(folder):
        _remove_abandoned(folder)
        path = folder / f"{_DRAFT}{uuid4().hex}"
        path.mkdir()
        handle = os.open(path, os.O_RDONLY)
        fcntl.flock(handle, fcntl.LOCK_EX)
    try:
        yield path
    finally:
        rmtree(path, ignore_errors=True)
        os.close(handle)


def write(path: Path, data: bytes) -> None:
    """Write a file through to the disk."""
    with path.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def replace(path: Path, data: bytes) -> None:
    """Write a file so that readers see the old one or the new one; needs the folder's lock."""
    with replacing(path) as beside:
        beside.write_bytes(data)
    sync(path.parent)


def _remove_abandoned(folder: Path) -> None:
    for path in folder.glob(f"{_DRAFT}*"):
        handle = os.open(path, os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            rmtree(path)
        except BlockingIOError:
            pass  # its writer lives
        finally:
            os.close(handle)
