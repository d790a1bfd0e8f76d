"""How a program that moves an arm ends: signals that wait for a cycle, and brakes at every exit.

Exits of a program: whichever it takes, arms that were commanded brake to rest before.

The end of a `with` block closes its robot, also when it is left by an exception, and Ctrl-C is
one. What is left open is closed when the interpreter ends. SIGTERM, SIGHUP (a terminal that was
closed) and SIGQUIT would end the process at once; while arms are commanded from the main thread,
they raise SystemExit there instead. In the middle of a cycle, they and Ctrl-C wait for its end:
else what was sent and what is remembered of it would not fit together. What comes while an arm
brakes, as from somebody who presses Ctrl-C again, is acted on once it stands. A handler that the
program has set itself is left alone.
"""

from __future__ import annotations

import atexit
import signal
import threading
import weakref
from collections.abc import Callable, Generator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final, NoReturn

from limo_driver.runtime.processes import Closing

ENDING: Final = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name)
)
_SIGNALLED: Final = 128  # plus the signal's number: the exit status that shells give


@contextmanager
def interrupts(note: Callable[[], None]) -> Generator[None]:
    """Turn the first SIGINT, SIGTERM, SIGHUP or SIGQUIT into a call of `note`.

    A second one acts as usual, and so does one that the program was started to ignore (nohup).
    Elsewhere than in the main thread, signals stay as they are.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, *ENDING)}
    previous = {n: handler for n, handler in handlers.items() if handler is not signal.SIG_IGN}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def take(*_: object) -> None:
        restore()
        note()

    for number in previous:
        signal.signal(number, take)
    try:
        yield
    finally:
        restore()


class Interruptible(Closing):
    """Closes, and ends a cycle before it heeds a signal."""

    interrupted: int = 0  # signal that came in the middle of a cycle


_open: Final[weakref.WeakSet[Interruptible]] = weakref.WeakSet()
_taken: Final[dict[int, Any]] = {}  # signals that would have ended the process, and by what
_WHOLE: Final = frozenset({"receive", "send", "close", "__exit__"})  # of a robot, done to the end


def guard(robot: Interruptible) -> None:
    """See to it that a robot is closed, however the program ends."""
    _open.add(robot)
    if threading.current_thread() is not threading.main_thread():
        return
    for number in (signal.SIGINT, *ENDING):
        before = signal.getsignal(number)
        if before in {signal.SIG_DFL, signal.default_int_handler}:
            signal.signal(number, _heed)
            _taken[number] = before


def release(robot: Interruptible) -> None:
    """Forget a robot that was closed; with the last one, signals act as before."""
    _open.discard(robot)
    if _open or threading.current_thread() is not threading.main_thread():
        return
    while _taken:
        number, before = _taken.popitem()
        if signal.getsignal(number) is _heed:
            signal.signal(number, before)


def leave(number: int) -> NoReturn:
    """End the program as a signal asks for."""
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    raise SystemExit(_SIGNALLED + number)


def _heed(number: int, frame: FrameType | None) -> None:
    while frame is not None:
        if frame.f_code.co_name in _WHOLE:
            here = frame.f_locals.get("self")
            for robot in _open:
                if robot is here:
                    robot.interrupted = number  # which ends the cycle before, or closes
                    return
        frame = frame.f_back
    leave(number)


@atexit.register
def _close_all() -> None:
    for robot in list(_open):
        with suppress(Exception, SystemExit, KeyboardInterrupt):  # each of the others brakes, too
            robot.close()
