"""Files of machine code: found by a digest of their sources, checked, never half-written."""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import pickle
import secrets
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_HEAD: Final = b"limo machine code 1\n"
_CHECK: Final = 32  # bytes of the digest behind it
_KEPT: Final = 8  # files of a function in a folder: versions and signatures
_LEFT_OVER: Final = 600.0  # [s] after which nobody is still writing a file
_PATIENCE: Final = 120.0  # [s] with a process that compiles the same; it may have been stopped
_LOOK: Final = 0.05  # [s] between two looks at whether it is done
_SUFFIX: Final = ".code"
_DRAFT: Final = ".tmp"
_LOCK: Final = ".lock"

_said = False
_log = logging.getLogger("limo")


class CodePlace:
    """Files in which the machine code of one function is kept.

    Args:
        source: Its file.
        name: Its full name.
        digest: Of all that its code comes from.
    """

    def __init__(self, source: str, name: str, digest: str) -> None:
        self._folders = _folders(source)
        self._name = name.replace("<", "").replace(">", "")  # of <locals>
        self._digest = digest

    def read(self, key: str) -> Sequence[Any] | None:
        """Return what is kept under a key, or None where it cannot be read, whatever the reason."""
        for folder in self._folders:
            try:
                content = (folder / self._file(key)).read_bytes()
            except OSError:
                continue
            if (found := _unpacked(content)) is not None:
                return found
        return None

    def write(self, key: str, content: Callable[[], bytes]) -> None:
        """Keep content under a key, in the first folder that takes it; say once where none does."""
        if not self._folders:
            _say_not_kept("neither NUMBA_CACHE_DIR nor HOME is set")
            return
        data = content()
        reason = ""
        for folder in self._folders:
            try:
                _write(folder / self._file(key), _packed(data))
            except OSError as error:
                reason = reason or f"{error.filename or folder}: {error.strerror}"
            else:
                self._tidy(folder)
                return
        _say_not_kept(reason)

    def claim(self, key: str, wait: Callable[[], None]) -> CodeLock | None:
        """Return once no other process is about to write under a key, so that one alone compiles.

        Args:
            key: What will be written.
            wait: Called often while another process has it.

        Returns:
            What others wait for until it is released; None where nothing can be locked, and where
            another process was waited for in vain.
        """
        for folder in self._folders:
            path = folder / f"{self._file(key)}{_LOCK}"
            try:
                folder.mkdir(parents=True, exist_ok=True)
                return _claimed(path, wait)
            except OSError:
                continue  # a folder that cannot be written, or a file system without locks
        return None

    def any(self) -> bool:
        """Say whether something is kept, under any key."""
        start = f"{self._name}-{self._digest}-"
        return any(
            name.startswith(start) and name.endswith(_SUFFIX)
            for folder in self._folders
            for name in _names(folder)
        )

    def _file(self, key: str) -> str:
        return f"{self._name}-{self._digest}-{_short(key)}{_SUFFIX}"

    def _tidy(self, folder: Path) -> None:
        """Remove what old versions, and writers that were killed, have left of this function."""
        try:
            own = [p for p in folder.iterdir() if p.name.startswith(f"{self._name}-")]
            own.sort(key=lambda path: path.stat().st_mtime, reverse=True)
            files = [path for path in own if path.suffix == _SUFFIX]
            left = [path for path in own if path.suffix in {_DRAFT, _LOCK}]
            old = time.time() - _LEFT_OVER
            for path in [*files[_KEPT:], *(p for p in left if p.stat().st_mtime < old)]:
                path.unlink()
        except OSError:
            pass  # another process tidies, too


class CodeLock:
    """A lock that ends with its process, whichever way that goes."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self._path, self._descriptor = path, descriptor

    def release(self) -> None:
        """Let others go on, and leave no file."""
        with suppress(OSError):
            self._path.unlink()
        os.close(self._descriptor)


def _claimed(path: Path, wait: Callable[[], None]) -> CodeLock | None:
    ends = time.monotonic() + _PATIENCE
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            while not _locked(descriptor):
                if time.monotonic() > ends:
                    os.close(descriptor)
                    return None
                wait()
                time.sleep(_LOOK)
            if _is_there(path, descriptor):
                return CodeLock(path, descriptor)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)  # who had it has removed it


def _locked(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is_there(path: Path, descriptor: int) -> bool:
    """Say whether an open file still is the one that others find."""
    try:
        return os.path.samestat(path.stat(), os.fstat(descriptor))
    except OSError:
        return False


def _write(path: Path, content: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(f"{path.name}.{secrets.token_hex(4)}{_DRAFT}")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise


def _folders(source: str) -> tuple[Path, ...]:
    """Return where machine code may be kept, the best first."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        return (Path(chosen).absolute() / "limo",)
    beside = Path(source).absolute().parent / "__pycache__"
    # Path.expanduser raises for a user without a home
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return (beside, Path(home) / "limo") if Path(home).is_absolute() else (beside,)


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def _packed(data: bytes) -> bytes:
    return _HEAD + _checksum(data) + data


def _unpacked(content: bytes) -> Sequence[Any] | None:
    """Return what a file holds, None if it is not whole."""
    data = content[len(_HEAD) + _CHECK :]
    if not content.startswith(_HEAD + _checksum(data)):
        return None
    try:
        return pickle.loads(data)  # noqa: S301  # from folders that programs are run from, too
    except Exception:  # noqa: BLE001  # a module that it names has gone, or the like
        return None


def _checksum(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=_CHECK).digest()


def _short(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _say_not_kept(reason: str) -> None:
    """Say so once in a process, on stderr unless the program has its own way with messages."""
    global _said  # noqa: PLW0603
    if not _said:
        _log.warning("limo: cannot keep machine code, so every process compiles anew: %s", reason)
    _said = True
