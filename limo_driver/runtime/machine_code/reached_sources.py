"""Digest of a compiled function: its byte code, and that of every function that it calls.

Not files: one may have changed since it was imported, and numba compiles what is in memory.
"""

from __future__ import annotations

import hashlib
import sys
from enum import Enum
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
_NUMBAS_OWN: Final = {"numpy", "math"}  # modules whose functions numba has itself
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
