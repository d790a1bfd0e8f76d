"""Main loop of the service: publish status once a second and at every change, until stopped."""

from __future__ import annotations

import gc
import math
import signal
import sys
import threading
import time
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import FrameType

    from estimators.service.arm_server import ArmServer

STATUS_PERIOD: Final = 1.0  # [s]
_SWITCH_INTERVAL: Final = 2e-4  # [s] that a thread may keep the interpreter from the stream's


def serve(
    servers: Sequence[ArmServer],
    duration: float | None,
    show: Callable[[dict[str, Any]], None],
) -> None:
    """Serve until SIGINT or SIGTERM, or for a time.

    Args:
        servers: One for each arm, which answer on threads of their own.
        duration: Time to serve [s]; without end if None.
        show: Told the status of each arm once a second, and when its phase changes.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.freeze()  # what is there stays; collecting through it would hold the stream
    gc.enable()  # whoever imported and loaded that had it off
    stopped = threading.Event()
    due: SimpleQueue[None] = SimpleQueue()  # whose `put` a signal handler may call at any time

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopped.set()
        due.put(None)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    for server in servers:
        server.tell_changes(lambda: due.put(None))
    ends = math.inf if duration is None else time.monotonic() + duration
    while not stopped.is_set() and time.monotonic() < ends:
        _show_all(servers, show)
        _wait(due, min(STATUS_PERIOD, ends - time.monotonic()))
    _show_all(servers, show)


def _wait(due: SimpleQueue[None], seconds: float) -> None:
    """Wait until the status is due, or something has changed meanwhile."""
    with suppress(Empty):
        due.get(timeout=max(seconds, 0.0))
    while not due.empty():  # what changed at the same time is told at once
        due.get()


def _show_all(servers: Sequence[ArmServer], show: Callable[[dict[str, Any]], None]) -> None:
    for server in servers:
        show(server.status())
