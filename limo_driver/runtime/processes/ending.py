"""Ending: what a program waits for that works until it is told to end."""

from __future__ import annotations

import select
import signal
import socket
import threading
import time
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from limo_driver.runtime.processes.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Generator
    from types import FrameType

_ENDING: Final = {signal.SIGINT, signal.SIGTERM}
_STOP: Final = b"\0"  # no signal has this number
_AT_ONCE: Final = 4096  # signals read
_LONGEST: Final = 1e6  # [s] that the operating system waits at once


class Ending(Closing):
    """SIGINT, SIGTERM, a call of `stop`, or the end of a time, whichever comes first."""

    def __init__(self) -> None:
        # A signal writes into the one end itself. A lock would not hear a signal that comes just
        # before it is waited for.
        self._heard, self._ended = socket.socketpair()
        self._ended.setblocking(False)

    def wait(self, duration: float | None = None) -> None:
        """Wait for the end.

        Elsewhere than in the main thread, signals stay as they are. In it, both do nothing more
        from now on, whoever needs them has to give them back.

        Args:
            duration: Longest wait [s]; without end if not given.
        """
        ends = None if duration is None else time.monotonic() + duration
        with self._signalled():
            while not self._asked_to_end(ends):
                pass

    def stop(self) -> None:
        """End `wait`, from any thread."""
        with suppress(OSError):  # closed, or so much was written that it will be heard
            self._ended.send(_STOP)

    def close(self) -> None:
        """Close both ends."""
        self._heard.close()
        self._ended.close()

    @contextmanager
    def _signalled(self) -> Generator[None]:
        """Let SIGINT and SIGTERM do nothing but end `wait`, where they can be listened to."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.set_wakeup_fd(self._ended.fileno(), warn_on_full_buffer=False)
        for number in _ENDING:
            signal.signal(number, _do_nothing)
        try:
            yield
        finally:
            signal.set_wakeup_fd(before)

    def _asked_to_end(self, ends: float | None) -> bool:
        """Wait for the next signal or `stop`, and say whether to go on no longer."""
        left = None if ends is None else min(max(ends - time.monotonic(), 0.0), _LONGEST)
        if select.select([self._heard], [], [], left)[0]:
            heard = self._heard.recv(_AT_ONCE)
            return _STOP in heard or not _ENDING.isdisjoint(heard)
        return ends is not None and time.monotonic() >= ends


def _do_nothing(_signal: int, _frame: FrameType | None) -> None:
    """Take a signal, which has written its number into the socket."""


@contextmanager
def signals_given_back() -> Generator[None]:
    """Give SIGINT and SIGTERM back, at the end of the block, to whom they were of before."""
    handlers = {number: signal.getsignal(number) for number in _ENDING}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():  # which alone can change them
            for number, handler in handlers.items():
                if handler is not None:  # else it is none of Python's
                    signal.signal(number, handler)
