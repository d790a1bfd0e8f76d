"""Keep the champion of one arm up to date, on a thread of its own, see `retraining`."""

from __future__ import annotations

import threading
from traceback import format_exc
from typing import TYPE_CHECKING, Any, Final

from estimators.service.retraining.retraining import Retraining
from limo_driver.network.messages import Level

if TYPE_CHECKING:
    from pathlib import Path

    from estimators.service.arm_server import ArmServer
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.live_model import Window
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.store import ModelStore

_PERIOD: Final = 1.0  # [s] between two looks


class Keeper:
    """Retrains the champion of an arm that is served; one thread, at most one training at a time.

    Args:
        server: Of the arm.
        store: Whose champion it serves.
        logs: Folder of the service's logs.
        settings: When, and how it is judged.
    """

    def __init__(
        self, server: ArmServer, store: ModelStore, logs: Path, settings: RetrainingSettings
    ) -> None:
        self._server = server
        self._retraining = Retraining(server, store, logs, settings)
        self._life = self._retraining.live()
        self._kept: ArmService | None = None  # whose states the stages are of
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Look once a second, on a thread of its own, until `close`."""
        self._thread = threading.Thread(target=self._look, name=f"limo-keep-{self._server.arm}")
        self._thread.start()

    def close(self) -> None:
        """Stop, and end a training that is under way; the next service goes on from here."""
        self._stopped.set()
        self._retraining.stop()
        if self._thread is not None:
            self._thread.join()
        self._retraining.close()

    def status(self) -> dict[str, Any]:
        """Return the stage of retraining and its facts, as JSON values."""
        return self._retraining.stage.as_values()

    def ask(self, reason: str) -> dict[str, Any]:
        """Train as soon as can be; what was being gathered for is trained at once.

        Raises:
            LimoError: A challenger is being trained or judged, or one was a short while ago, or
                what serves is not the champion.
        """
        self._retraining.ask(reason)
        return self.status()

    def watch(self, window: Window) -> None:
        """Take the service's summary of the last second or so."""
        self._retraining.watch(window)

    def tick(self) -> None:
        """Take the next step; report a failure of this program, and begin again."""
        try:
            if self._server.service is not self._kept:
                self._begin_anew()
            if self._kept is not None and not self._server.answering:
                return
            next(self._life)
        except Exception as error:  # noqa: BLE001  # the stream has to go on
            self._server.outlet.event(
                "failure", f"retraining: {error!r}", Level.FATAL, trace=format_exc()
            )
            self._life = self._retraining.recover()

    def _begin_anew(self) -> None:
        """Go on with states of another rate, like a service that has just started."""
        if self._kept is not None:
            self._life.close()
            self._life = self._retraining.begin_anew()
        self._kept = self._server.service

    def _look(self) -> None:
        while not self._stopped.wait(_PERIOD):
            self.tick()
