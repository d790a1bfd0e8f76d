"""Main loop of the service: publish status once a second and at every change, until closed."""

from __future__ import annotations

import gc
import sys
import threading
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Final

from limo_driver.runtime.processes import Closing, Ending, signals_given_back

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Mapping, Sequence

    from estimators.service.arm_server import ArmServer
    from limo_driver.logs.mcap_log import McapLog
    from limo_driver.network.readiness import ServicePhase

STATUS_PERIOD: Final = 1.0  # [s]
_SWITCH_INTERVAL: Final = 2e-4  # [s] that a thread may keep the interpreter from the stream's


@contextmanager
def as_before() -> Generator[None]:
    """Give back, at the end of the block, what a service changes of the process it is in."""
    interval = sys.getswitchinterval()
    try:
        with signals_given_back():
            yield
    finally:
        sys.setswitchinterval(interval)


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
        self._ending = Ending()
        self._stopped = threading.Event()
        self._failure: BaseException | None = None
        sys.setswitchinterval(_SWITCH_INTERVAL)
        gc.freeze()  # what is there stays; collecting through it would hold the stream
        for server in servers:
            server.tell_changes(lambda: self._due.put(None))
        self._thread = threading.Thread(target=self._tell, name="limo-status")
        self._thread.start()

    @property
    def lost_logs(self) -> dict[str, str]:
        """Why logs ended before the service did, by arm."""
        return {arm: str(log.failure) for arm, log in self.logs.items() if log.failure is not None}

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
        self._ending.wait(duration)
        if self._failure is not None:
            raise self._failure

    def stop(self) -> None:
        """End `wait`, from any thread; the service goes on until it is closed."""
        self._ending.stop()

    def close(self) -> None:
        """Tell the status once more, and no more."""
        self._stopped.set()
        self._due.put(None)
        self._thread.join()
        self._ending.close()

    def _tell(self) -> None:
        try:
            while not self._stopped.is_set():
                self._show_all()
                # Wait until the status is due, or something has changed meanwhile
                with suppress(Empty):
                    self._due.get(timeout=STATUS_PERIOD)
                while not self._due.empty():  # what changed at the same time is told at once
                    self._due.get()
            self._show_all()
        except BaseException as error:  # noqa: BLE001  # `wait` raises it
            self._failure = error
            self.stop()

    def _show_all(self) -> None:
        for server in self._servers:
            self._show(server.status())
