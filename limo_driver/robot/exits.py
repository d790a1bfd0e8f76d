"""Exits of a program: whichever it takes, arms that were commanded brake to rest before.

The end of a `with` block closes its robot, also when it is left by an exception, and Ctrl-C is
one. What is left open is closed when the interpreter ends. SIGTERM, SIGHUP (a terminal that was
closed) and SIGQUIT would end the process at once; while arms are commanded from the main thread,
they raise SystemExit there instead. A handler that the program has set itself is left alone.
"""

from __future__ import annotations

import atexit
import signal
import threading
import weakref
from contextlib import suppress
from typing import TYPE_CHECKING, Final, NoReturn

if TYPE_CHECKING:
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


def _leave(number: int, _frame: FrameType | None) -> NoReturn:
    raise SystemExit(_SIGNALLED + number)


@atexit.register
def _close_all() -> None:
    for robot in list(_open):
        with suppress(Exception):  # each of the others brakes, too
            robot.close()
