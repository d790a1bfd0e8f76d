"""Outputs: refused before long work where nothing can be written, or where an input lies.

What is written is there in full or not at all, on a full disk as well.
"""

from __future__ import annotations

import errno
import fcntl
import json
import math
import os
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any, cast

from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Mapping

PARQUET = (".parquet", ".pq")  # endings of what is written
PAGES = (".html", ".htm")


def require_file(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Check that a file can be written.

    Args:
        path: To be written; one that is there is written over.
        inputs: Files that are read, which must not be.

    Raises:
        ConfigError: It cannot be written, or is one of the inputs.
    """
    if path.is_dir():
        raise ConfigError("cannot be written: it is a folder, expected a file", path=path)
    if not path.parent.is_dir():
        raise ConfigError(f"cannot be written: there is no folder {path.parent}", path=path)
    require_apart([path], inputs)
    try:
        with path.open("ab") if path.exists() else TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror}", path=path) from None


def page_of(path: Path) -> Path | None:
    """Return where the page about a file goes: `sim.yaml` has `sim.html` beside it.

    Returns:
        None for what is no regular file, such as `/dev/null`: nothing stands beside it.
    """
    return None if path.exists() and not path.is_file() else path.with_suffix(".html")


def require_parquet(path: Path | str) -> None:
    """Check that the name of a file does not promise another format than Parquet.

    Args:
        path: To be written; without an ending, it promises nothing.

    Raises:
        ConfigError: Its ending is that of another format.
    """
    _require_ending(Path(path), "Parquet", PARQUET)


def require_page(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Check that a page can be written, as `require_file` does, and that its name promises one.

    Args:
        path: To be written; without an ending, it promises nothing.
        inputs: Files that are read, which must not be.

    Raises:
        ConfigError: It cannot be written, is one of the inputs, or has another ending.
    """
    require_file(path, inputs)
    if path.is_file() or not path.exists():  # what is neither, as /dev/null, has no format
        _require_ending(path, "a page in HTML", PAGES)


def _require_ending(path: Path, written: str, endings: tuple[str, ...]) -> None:
    ending = path.suffix
    if ending.lower() not in {"", *endings}:
        raise ConfigError(
            f"cannot be written: {written} is written, and its name ends in {ending}; expected "
            f"{' or '.join(endings)}",
            path=path,
        )


def require_folder(
    folder: Path, holds: str, names: Iterable[str] = (), inputs: Iterable[Path] = ()
) -> None:
    """Make a folder, if there is none, and check that it can be written to.

    As `require_place` does, but for making it.

    Args:
        folder: To be written to.
        holds: What it is for, e.g. "the diagnosis".
        names: Files that will be written in it.
        inputs: Files that are read, which must not be written over.

    Raises:
        ConfigError: It is a file, cannot be written to, or an input would be written over.
    """
    require_place(folder, holds, names, inputs)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error.strerror}", path=folder) from None
    require_place(folder, holds)


def require_place(
    folder: Path, holds: str, names: Iterable[str] = (), inputs: Iterable[Path] = ()
) -> None:
    """Check that a folder can be made or written to, and make nothing: the work may yet fail.

    Args:
        folder: To be written to.
        holds: What it is for, e.g. "the diagnosis".
        names: Files that will be written in it.
        inputs: Files that are read, which must not be written over.

    Raises:
        ConfigError: It is a file, cannot be written to, or an input would be written over.
    """
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"is a file, expected a folder for {holds}", path=folder)
    require_apart([folder / name for name in names], inputs)
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    try:
        with TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise ConfigError(f"cannot be written to: {error.strerror}", path=folder) from None


@contextmanager
def whole(path: Path | str) -> Generator[Path]:
    """Give a name beside a file to write to, which takes the file's place once it is complete.

    Where something fails, what was there stays, and nothing else does. What is no regular file,
    such as `/dev/null`, is written to itself.

    Raises:
        ConfigError: It cannot be written.
    """
    try:
        with replacing(path) as draft:
            yield draft
    except OSError as error:
        raise ConfigError(f"cannot be written: {reason(error)}", path=path) from None


@contextmanager
def replacing(path: Path | str) -> Generator[Path]:
    """Do as `whole` does, for whoever knows more to say of an error.

    Raises:
        OSError: It cannot be written.
    """
    target = Path(path).resolve()
    straight = target.exists() and not target.is_file()
    draft = target if straight else target.with_name(f".{target.name}.writing")
    try:
        yield draft
        if not straight:
            sync(draft)
            draft.replace(target)
    finally:
        if not straight:
            draft.unlink(missing_ok=True)


def reason(error: OSError) -> str:
    """Return the reason of a failure, without the words that a library adds."""
    return os.strerror(error.errno) if error.errno else str(error)


def disk_is_full(error: OSError) -> bool:
    """Say whether a file could not be written for want of room, rather than for anything else."""
    return error.errno in {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


def sync(path: Path) -> None:
    """Bring a file, or the names in a folder, to the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def require_apart(written: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Check that no file that is read is written over.

    Raises:
        ConfigError: One is.
    """
    taken = {path.resolve() for path in written}
    for path in inputs:
        if path.resolve() in taken:
            raise ConfigError("is read and would be written over; write elsewhere", path=path)


@contextmanager
def only_writer(folder: Path) -> Generator[None]:
    """Be the only process that writes to a folder; the claim goes with the process that has it.

    Raises:
        ConfigError: Another process is writing to it.
    """
    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(
                "another process is writing to it; wait for its end, or give another folder",
                path=folder,
            ) from None
        yield


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


def plain_json(value: Any) -> Any:  # noqa: ANN401
    """Return a value as JSON has it: lists, texts and numbers; what is not finite is null."""
    if isinstance(value, dict):
        return {str(key): plain_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(item) for item in value]
    if hasattr(value, "item"):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
