"""The loop of the service: status once a second until it is told to stop."""

from __future__ import annotations

import gc
import signal
import sys
import threading
import time
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
        show: Told the status of each arm once a second.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL)
    gc.freeze()  # what is there stays; collecting through it would hold the stream
    gc.enable()  # whoever imported and loaded that had it off
    stopped = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopped.set()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    ends = None if duration is None else time.monotonic() + duration
    while not stopped.is_set() and (ends is None or time.monotonic() < ends):
        stopped.wait(STATUS_PERIOD if ends is None else min(STATUS_PERIOD, ends - time.monotonic()))
        for server in servers:
            show(server.status())
