"""Publish phases and events of one arm's service, also those from before it joined a network."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

from limo_driver.network.messages import LOG, Event, Level
from limo_driver.network.streaming import declare_history, to_json

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh.ext

    from limo_driver.logs.mcap_log import McapLog
    from limo_driver.network.readiness import ServicePhase
    from limo_driver.network.streaming import Keys


class Bulletin:
    """Tells events and phases of one arm's service at once, and publishes them when it has joined.

    Args:
        keys: Of the arm.
        tell: Told every event, for people who watch the service itself.
    """

    def __init__(self, keys: Keys, tell: Callable[[Event], None]) -> None:
        self.keys, self._tell = keys, tell
        self.phase: ServicePhase | None = None
        self.state = ""  # the phase in words
        self.wake: Callable[[], None] | None = None  # who publishes the status, if one does
        self.log: McapLog | None = None  # keeps the events, if one does
        self._lock = threading.Lock()
        self._unpublished: list[bytes] = []  # events from before it joined
        self._publishers: tuple[zenoh.ext.AdvancedPublisher, ...] = ()

    def join(self, session: zenoh.Session) -> None:
        """Publish everything so far, and all that follows; a second call does nothing."""
        with self._lock:
            if self._publishers:
                return
            event = declare_history(session, self.keys.event)
            status = declare_history(session, self.keys.status("service"), kept=1)
            for payload in self._unpublished:
                event.put(payload)
            self._unpublished.clear()
            if self.phase is not None:
                status.put(to_json(self.condition()))
            self._publishers = event, status

    def enter(
        self,
        phase: ServicePhase,
        text: str,
        level: Level = Level.INFO,
        state: str = "",
        **facts: object,
    ) -> None:
        """Let the status say a phase, at once; a change of it is an event, too.

        Args:
            phase: How far the service is.
            text: What it does now, in one sentence.
            level: Of the event.
            state: The phase in words, where there is more to say than its name: how much is
                done, or why not.
            facts: Of the event.
        """
        changed, self.phase, self.state = phase is not self.phase, phase, state or phase.value
        if changed:
            self.event(phase.value, text, level, phase=phase.value, **facts)
        if self.wake is None:
            self.status(self.condition())
        elif changed:
            self.wake()

    def event(self, kind: str, text: str, level: Level = Level.INFO, **facts: object) -> None:
        """Tell, publish and log what happened."""
        event = Event(time.time_ns(), level, kind, text, facts)
        payload = event.encode()
        with self._lock:
            if self._publishers:
                self._publishers[0].put(payload)
            else:
                self._unpublished.append(payload)
        if self.log is not None:
            self.log.write(self.keys.event, LOG, payload, time.time_ns(), event.stamp_ns, 0)
        self._tell(event)

    def condition(self) -> dict[str, Any]:
        """Return how far the service is, as JSON values."""
        return {
            "arm": self.keys.arm,
            "time_ns": time.time_ns(),
            "phase": None if self.phase is None else self.phase.value,
            "state": self.state,
        }

    def status(self, status: dict[str, Any]) -> None:
        """Publish the condition of the service."""
        with self._lock:
            if self._publishers:
                self._publishers[1].put(to_json(status))

    def close(self) -> None:
        """Take the keys off the network."""
        with self._lock:
            for publisher in self._publishers:
                publisher.undeclare()
            self._publishers = ()
