"""Where the results of one arm go: the network, and the log."""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from limo_driver.messages import JOINT_STATE, LOG, TORQUE_ESTIMATE, Event, Level
from limo_driver.streaming import declare_history, declare_stream, to_json

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from limo_driver.mcap_log import McapLog
    from limo_driver.streaming import Keys

_RECENT: Final = 20  # events that the status shows


class NetworkOutlet:
    """Publishes estimates, external torque, events and status of one arm, and logs them.

    Args:
        session: Open Zenoh session.
        keys: Of the arm.
        log: Where everything is kept, if anywhere.
        tell: Told every event, for people who watch the service itself.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: Keys,
        log: McapLog | None,
        tell: Callable[[Event], None],
    ) -> None:
        self._keys, self._log, self._tell = keys, log, tell
        self._estimate = declare_stream(session, keys.estimate)
        self._external = declare_stream(session, keys.external)
        self._event = declare_history(session, keys.event)
        self._status = declare_history(session, keys.status("service"), kept=1)
        self.external_wanted = False
        self._matching = self._external.declare_matching_listener(self._match)
        self.recent: deque[Event] = deque(maxlen=_RECENT)
        self.published = 0

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:
        """Publish and log a torque estimate."""
        self._estimate.put(payload, attachment=attachment)
        self.published += 1
        self.log(self._keys.estimate, TORQUE_ESTIMATE, payload, stamp_ns)

    def external(self, payload: bytes, attachment: bytes) -> None:
        """Publish an external torque, -Jᵀ F of what pushes the arm; the log has it in estimates."""
        self._external.put(payload, attachment=attachment)

    def state(self, payload: bytes, stamp_ns: int, sequence: int) -> None:
        """Log a joint state as it came."""
        self.log(self._keys.joints, JOINT_STATE, payload, stamp_ns, sequence)

    def _match(self, status: zenoh.MatchingStatus) -> None:
        self.external_wanted = bool(status.matching)

    def event(self, kind: str, text: str, level: Level = Level.INFO, **facts: object) -> None:
        """Publish, log and tell what happened."""
        event = Event(time.time_ns(), level, kind, text, facts)
        payload = event.encode()
        self.recent.append(event)
        self._event.put(payload)
        self.log(self._keys.event, LOG, payload, event.stamp_ns)
        self._tell(event)

    def status(self, status: dict[str, Any]) -> None:
        """Publish the condition of the service."""
        self._status.put(to_json(status))

    def log(
        self, topic: str, schema: str, payload: bytes, stamp_ns: int, sequence: int = 0
    ) -> None:
        """Hand a message to the log, which writes it when it can."""
        if self._log is not None:
            self._log.write(topic, schema, payload, time.time_ns(), stamp_ns, sequence)

    def close(self) -> None:
        """Take the keys off the network."""
        self._matching.undeclare()
        for publisher in (self._estimate, self._external, self._event, self._status):
            publisher.undeclare()
