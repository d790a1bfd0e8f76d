"""What the machine code of a function comes from: its sources, and those of all that it calls."""

from __future__ import annotations

import hashlib
import sys
from enum import Enum
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import TYPE_CHECKING, Any, Final

import llvmlite
import numba
import numpy as np
from numba.core.dispatcher import Dispatcher
from numba.core.types import Type

if TYPE_CHECKING:
    from collections.abc import Iterator

_PLAIN: Final = (bool, int, float, complex, str, bytes, type(None), np.generic, Enum, Type)
_COMPILER: Final = (numba.__version__, llvmlite.__version__, sys.version)


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
    """Return a function's options, its file, and the values of what it uses."""
    function = dispatcher.py_func
    used = sorted((name, _value(value)) for name, value in _used(function))
    options = sorted((name, _value(value)) for name, value in dispatcher.targetoptions.items())
    source = _content(function.__code__.co_filename) or function.__code__.co_code
    return function.__module__, function.__qualname__, options, source, used


def _used(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """Yield what a function finds by name outside of itself, also in modules that it names."""
    names = {name for code in _codes(function.__code__) for name in code.co_names}
    for name in sorted(names & function.__globals__.keys()):
        value = function.__globals__[name]
        yield name, value
        if isinstance(value, ModuleType) and not value.__name__.startswith(("numpy", "math")):
            members = vars(value)
            yield from (
                (f"{name}.{member}", members[member]) for member in sorted(names & members.keys())
            )
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield name, cell.cell_contents


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
    return repr((type(value).__qualname__, _content(code.co_filename) if code else ""))


@cache  # read once for a process: what is imported does not change any more
def _content(path: str) -> bytes:
    """Return a digest of a file, nothing if it cannot be read."""
    try:
        return hashlib.blake2b(Path(path).read_bytes(), digest_size=16).digest()
    except OSError:
        return b""
