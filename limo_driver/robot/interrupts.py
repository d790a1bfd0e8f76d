"""Signal handling: let Ctrl-C and SIGTERM end a program in order."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Generator


@contextmanager
def interrupts(note: Callable[[], None]) -> Generator[None]:
    """Turn the first SIGINT or SIGTERM into a call of `note`; a second one acts as usual.

    Elsewhere than in the main thread, signals stay as they are.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

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
