"""Files of machine code: found by a digest of their sources, checked, never half-written.

Digest of a compiled function: its byte code, and that of every function that it calls.

Not files: one may have changed since it was imported, and numba compiles what is in memory.
"""

from __future__ import annotations

import fcntl
import hashlib
import logging
import os
import pickle
import secrets
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from enum import Enum
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, Final

import llvmlite
import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.types import Type

_HEAD: Final = b"limo machine code 1\n"
_CHECK: Final = 32  # bytes of the digest behind it
_KEPT: Final = 8  # files of a function in a folder: versions and signatures
_LEFT_OVER: Final = 600.0  # [s] after which nobody is still writing a file
_PATIENCE: Final = 120.0  # [s] with a process that compiles the same; it may have been stopped
_LOOK: Final = 0.05  # [s] between two looks at whether it is done
_SUFFIX: Final = ".code"
_DRAFT: Final = ".tmp"
_LOCK: Final = ".lock"

_warned = False
_log = logging.getLogger("limo")
_PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), np.generic, Enum, Type)
_NUMBAS_OWN: Final = {"numpy", "math"}  # modules whose functions numba has itself
_COMPILER: Final = (numba.__version__, llvmlite.__version__, sys.version)


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
    global _warned  # noqa: PLW0603
    if not _warned:
        _log.warning("limo: cannot keep machine code, so every process compiles anew: %s", reason)
    _warned = True


def digest(dispatcher: Dispatcher) -> str:
    """Return what changes whenever the machine code of a function could, and only then."""
    described = [_described(dispatcher), *sorted(map(_described, reached(dispatcher)))]
    return hashlib.blake2b(repr((_COMPILER, described)).encode(), digest_size=8).hexdigest()


def reached(dispatcher: Dispatcher) -> tuple[Dispatcher, ...]:
    """Return all other compiled functions that one calls, itself or through others."""
    found: dict[Dispatcher, None] = {dispatcher: None}
    waiting = [dispatcher]
    while waiting:
        called = [v for _, v in _used(waiting.pop().py_func) if isinstance(v, Dispatcher)]
        waiting += [each for each in called if each not in found]
        found.update(dict.fromkeys(called))
    return tuple(found)[1:]


def _described(dispatcher: Dispatcher) -> tuple[object, ...]:
    """Return a function's options, its byte code, and the values of what it uses."""
    function = dispatcher.py_func
    used = sorted((name, _value(value)) for name, value in _used(function))
    options = sorted((name, _value(value)) for name, value in dispatcher.targetoptions.items())
    return function.__module__, function.__qualname__, options, _body(function.__code__), used


def _body(code: CodeType) -> tuple[object, ...]:
    """Return what byte code does, the same in every process."""
    return (
        code.co_code,
        code.co_names,
        code.co_varnames,
        code.co_argcount,
        _constant(code.co_consts),
    )


def _constant(value: Any) -> object:  # noqa: ANN401
    """Return a constant of byte code, the same in every process."""
    if isinstance(value, CodeType):
        return _body(value)
    if isinstance(value, tuple):
        return tuple(_constant(each) for each in value)
    return sorted(map(repr, value)) if isinstance(value, frozenset) else repr(value)


def _used(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield what a function finds by name outside of itself, also in modules that it names."""
    names = {name for code in _codes(function.__code__) for name in code.co_names}
    yield from _found(names, function.__globals__)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield name, cell.cell_contents


def _found(
    names: set[str], among: dict[str, Any], path: tuple[str, ...] = ()
) -> Iterator[tuple[str, Any]]:
    """Yield what names stand for, with the members that modules among it have of these names."""
    for name in sorted(names & among.keys()):
        value = among[name]
        yield ".".join((*path, name)), value
        if not isinstance(value, ModuleType) or name in path:  # a module may name itself
            continue
        if value.__name__.partition(".")[0] not in _NUMBAS_OWN:
            yield from _found(names, vars(value), (*path, name))


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


def _value(value: Any) -> str:  # noqa: ANN401
    """Return what compiled code could depend on in a value, the same in every process."""
    if isinstance(value, _PLAIN):
        return repr(value)
    if isinstance(value, (tuple, list)):
        return repr([_value(each) for each in value])
    if isinstance(value, (set, frozenset)):
        return repr(sorted(map(_value, value)))
    if isinstance(value, np.ndarray):
        return repr((value.dtype.str, value.shape, value.tobytes()))
    if isinstance(value, type):
        return repr((value.__qualname__, getattr(value, "_fields", ())))
    defined = getattr(value, "_defn", value)  # an intrinsic's
    code = getattr(defined, "__code__", None)
    return repr((type(value).__qualname__, _body(code) if code else ""))
