"""Whether the log is being written: said in the status, told when it stops, and tried again."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from limo_driver.network.messages import Level

if TYPE_CHECKING:
    from estimators.service.inference.arm_service import Outlet
    from limo_driver.logs.mcap_log import McapLog

PAUSE: Final = 60.0  # [s] before a log that stopped is begun again


class LogWatch:
    """Looks after the log of one arm, each time that its status is taken.

    Args:
        log: That may stop: a full disk, for example.
        outlet: Told when it does, and when it goes on.
    """

    def __init__(self, log: McapLog, outlet: Outlet) -> None:
        self._log, self._outlet = log, outlet
        self._stopped = False  # and that was told
        self._written = 0  # when it stopped
        self._next_try = 0.0  # [s]

    def look(self) -> dict[str, Any]:
        """Tell what changed, try again if it is time to, and return the condition as JSON."""
        log, failure = self._log, self._log.failure
        if failure is not None and not self._stopped:
            self._stopped, self._written = True, log.written
            self._next_try = time.monotonic() + PAUSE
            self._outlet.event(
                "log",
                f"logging stopped: {failure}; it is tried again every {PAUSE:g} s",
                Level.ERROR,
                dropped=log.dropped,
            )
        elif failure is not None and time.monotonic() >= self._next_try:
            self._next_try = time.monotonic() + PAUSE
            log.resume()
        elif self._stopped and failure is None and log.written > self._written:
            self._stopped = False
            self._outlet.event("log", "logging goes on", dropped=log.dropped)
        return {
            "written": log.written,
            "dropped": log.dropped,
            "failure": None if failure is None else str(failure) or repr(failure),
        }
