"""Progress of numba compilation in this process, as a value and through a callback.

Nothing heavy is imported here, so that a program can ask, or show progress, before anything that
compiles is loaded; `limo_driver.runtime.compiled` says what happens.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Compilation:
    """Progress of compiling functions of which this machine keeps no machine code yet."""

    function: str  # that is compiled now, or was last
    running: bool
    done: int  # functions compiled by this process
    most: int  # that it will have compiled if it comes to use all that it has imported
    seconds: float  # spent on it, until now


_callbacks: list[Callable[[Compilation], None]] = []
_last: Compilation | None = None


def current() -> Compilation | None:
    """Return how far compilation is; None if this process has compiled nothing."""
    return _last


def is_running() -> bool:
    """Say whether something is being compiled now, in any thread."""
    return _last is not None and _last.running


@contextmanager
def report_to(callback: Callable[[Compilation], None]) -> Generator[None]:
    """Have `callback` called, inside, as compilation begins, goes on (often) and ends.

    It is called in the thread that compiles, which waits for it, and may raise to stop it.
    """
    _callbacks.append(callback)
    try:
        yield
    finally:
        _callbacks.remove(callback)


def tell(state: Compilation) -> None:
    """Take in how far compilation is, and pass it on."""
    global _last  # noqa: PLW0603  # a process has one compiler
    _last = state
    for callback in tuple(_callbacks):
        callback(state)
