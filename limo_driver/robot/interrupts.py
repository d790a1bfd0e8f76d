"""Signal handling: let Ctrl-C and the signals that end a program end it in order."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

from limo_driver.robot.exits import ENDING

if TYPE_CHECKING:
    from collections.abc import Callable, Generator


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
