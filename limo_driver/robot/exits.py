"""Exits of a program: whichever it takes, arms that were commanded brake to rest before.

The end of a `with` block closes its robot, also when it is left by an exception, and Ctrl-C is
one. What is left open is closed when the interpreter ends. SIGTERM, SIGHUP (a terminal that was
closed) and SIGQUIT would end the process at once; while arms are commanded from the main thread,
they raise SystemExit there instead. A handler that the program has set itself is left alone. What
comes while an arm brakes, as from somebody who presses Ctrl-C again, is acted on once it stands.
"""

from __future__ import annotations

import atexit
import signal
import threading
import weakref
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final, NoReturn

if TYPE_CHECKING:
    from collections.abc import Generator
    from types import FrameType

    from limo_driver.closing import Closing

ENDING: Final = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)
_SIGNALLED: Final = 128  # plus the signal's number: the exit status that shells give

_open: Final[weakref.WeakSet[Closing]] = weakref.WeakSet()
_taken: Final[set[int]] = set()  # signals whose default was to end the process


def guard(robot: Closing) -> None:
    """See to it that a robot is closed, however the program ends."""
    _open.add(robot)
    if threading.current_thread() is not threading.main_thread():
        return
    for number in ENDING:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _leave)
            _taken.add(number)


def release(robot: Closing) -> None:
    """Forget a robot that was closed; with the last one, signals act as before."""
    _open.discard(robot)
    if _open or threading.current_thread() is not threading.main_thread():
        return
    while _taken:
        number = _taken.pop()
        if signal.getsignal(number) is _leave:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def deferred() -> Generator[None]:
    """Let signals that would end the program wait for the end of the block, which has to be short.

    Elsewhere than in the main thread, where none arrives, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDING)}
    taken = {number: handler for number, handler in handlers.items() if callable(handler)}
    for number in taken:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in taken.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


def _leave(number: int, _frame: FrameType | None) -> NoReturn:
    raise SystemExit(_SIGNALLED + number)


@atexit.register
def _close_all() -> None:
    for robot in list(_open):
        with suppress(Exception, SystemExit, KeyboardInterrupt):  # each of the others brakes, too
            robot.close()
