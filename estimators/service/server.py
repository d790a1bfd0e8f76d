"""Main loop of the service: publish status once a second and at every change, until closed."""

from __future__ import annotations

import gc
import select
import signal
import socket
import sys
import threading
import time
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

from limo_driver.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence
    from types import FrameType

    from estimators.service.arm_server import ArmServer
    from limo_driver.logs.mcap_log import McapLog
    from limo_driver.network.readiness import ServicePhase

STATUS_PERIOD: Final = 1.0  # [s]
_SWITCH_INTERVAL: Final = 2e-4  # [s] that a thread may keep the interpreter from the stream's
_ENDING: Final = {signal.SIGINT, signal.SIGTERM}
_STOP: Final = b"\0"  # no signal has this number
_AT_ONCE: Final = 4096  # signals read
_LONGEST: Final = 1e6  # [s] that the operating system waits at once


def _do_nothing(_signal: int, _frame: FrameType | None) -> None:
    """Take a signal, which has written its number into the socket."""


@contextmanager
def as_before() -> Generator[None]:
    """Give back, at the end of the block, what a service changes of the process it is in."""
    interval = sys.getswitchinterval()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        if threading.current_thread() is threading.main_thread():  # which alone can change them
            for number, handler in handlers.items():
                if handler is not None:  # else it is none of Python's
                    signal.signal(number, handler)


class Service(Closing):
    """Arms that are served on threads of their own, and told about on one more.

    Args:
        servers: One for each arm, which whoever made them closes afterwards.
        show: Told the status of each arm once a second, and when its phase changes; from another
            thread.
        logs: Of the arms that are logged.
    """

    def __init__(
        self,
        servers: Sequence[ArmServer],
        show: Callable[[dict[str, Any]], None],
        logs: Mapping[str, McapLog],
    ) -> None:
        self.logs = logs
        self._servers, self._show = servers, show
        self._due: SimpleQueue[None] = SimpleQueue()  # something changed
        # A signal writes into the one end itself. A lock would not hear a signal that comes just
        # before it is waited for.
        self._heard, self._ended = socket.socketpair()
        self._ended.setblocking(False)
        self._stopped = threading.Event()
        self._failure: BaseException | None = None
        sys.setswitchinterval(_SWITCH_INTERVAL)
        gc.freeze()  # what is there stays; collecting through it would hold the stream
        for server in servers:
            server.tell_changes(lambda: self._due.put(None))
        self._thread = threading.Thread(target=self._tell, name="limo-status")
        self._thread.start()

    @property
    def phases(self) -> dict[str, ServicePhase | None]:
        """How far the service of each arm is."""
        return {server.arm: server.phase for server in self._servers}

    def wait(self, duration: float | None = None) -> None:
        """Wait until SIGINT or SIGTERM, until `stop`, or for a time.

        Elsewhere than in the main thread, signals stay as they are. In it, both do nothing more
        from now on: whoever made the service gives them back once all is closed, see `as_before`.

        Args:
            duration: Longest wait [s]; without end if not given.

        Raises:
            Exception: What ended the telling of the status, such as an output that is gone.
        """
        ends = None if duration is None else time.monotonic() + duration
        with self._signalled():
            while not self._asked_to_end(ends):
                pass
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End `wait`, from any thread; the service goes on until it is closed."""
        with suppress(OSError):  # closed, or so much was written that it will be heard
            self._ended.send(_STOP)

    def close(self) -> None:
        """Tell the status once more, and no more."""
        self._stopped.set()
        self._due.put(None)
        self._thread.join()
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

    def _tell(self) -> None:
        try:
            while not self._stopped.is_set():
                self._show_all()
                self._wait_for_change()
            self._show_all()
        except BaseException as error:  # noqa: BLE001  # `wait` raises it
            self._failure = error
            self.stop()

    def _wait_for_change(self) -> None:
        """Wait until the status is due, or something has changed meanwhile."""
        with suppress(Empty):
            self._due.get(timeout=STATUS_PERIOD)
        while not self._due.empty():  # what changed at the same time is told at once
            self._due.get()

    def _show_all(self) -> None:
        for server in self._servers:
            self._show(server.status())
