"""Processes and threads beside the service, which the stream must not feel."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Final

_LEAST: Final = 19
_ABANDONED: Final = 3  # exit status


def give_way(nice: int) -> None:
    """Take the CPU only when others leave it, from now on.

    Args:
        nice: 19 gives way the most.
    """
    os.nice(nice)
    if os.getsid(0) == os.getpid():  # in a group of its own, whose weight is what counts then
        with suppress(OSError):  # a kernel without such groups
            Path("/proc/self/autogroup").write_text(str(nice))


def end_when_abandoned() -> None:
    """End this process when whoever holds the other end of its standard input is gone.

    However that one ended: nobody would hear the result, and another may have begun the same.
    """

    def wait() -> None:
        with suppress(OSError):
            while os.read(0, 1):
                pass
        os._exit(_ABANDONED)

    threading.Thread(target=wait, name="limo-abandoned", daemon=True).start()


def thread_aside(name: str) -> ThreadPoolExecutor:
    """Return a thread that takes the CPU only when others leave it, where the system can say so.

    What runs there must hold no lock that the stream waits for.
    """
    return ThreadPoolExecutor(1, name, initializer=_give_way_thread)


def _give_way_thread() -> None:
    with suppress(OSError):  # threads have priorities of their own on Linux only
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _LEAST)
