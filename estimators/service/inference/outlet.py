"""Publish and log the results of one arm.

The status says whether the log is being written; an event tells when writing stops, and it is
tried again.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from limo_driver.network.messages import JOINT_STATE, TORQUE_ESTIMATE, Level
from limo_driver.network.streaming import declare_stream

if TYPE_CHECKING:
    import zenoh

    from estimators.service.inference.arm_service import Outlet
    from estimators.service.inference.bulletin import Bulletin
    from limo_driver.logs.mcap_log import McapLog

PAUSE: Final = 60.0  # [s] before a log that stopped is begun again


class NetworkOutlet:
    """Publishes estimates, external torque, events and status of one arm, and logs them.

    Args:
        session: Open Zenoh session.
        bulletin: Of the arm, which joins the session here at the latest.
        log: Where everything is kept, if anywhere.
    """

    def __init__(self, session: zenoh.Session, bulletin: Bulletin, log: McapLog | None) -> None:
        keys = bulletin.keys
        self._keys, self._log, self._bulletin = keys, log, bulletin
        bulletin.log = log
        bulletin.join(session)
        self._estimate = declare_stream(session, keys.estimate)
        self._external = declare_stream(session, keys.external)
        self.external_wanted = False
        self._matching = self._external.declare_matching_listener(self._match)

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:
        """Publish and log a torque estimate."""
        self._estimate.put(payload, attachment=attachment)
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
        self._bulletin.event(kind, text, level, **facts)

    def log(
        self, topic: str, schema: str, payload: bytes, stamp_ns: int, sequence: int = 0
    ) -> None:
        """Hand a message to the log, which writes it when it can."""
        if self._log is not None:
            self._log.write(topic, schema, payload, time.time_ns(), stamp_ns, sequence)

    def close(self) -> None:
        """Take the keys off the network."""
        self._matching.undeclare()
        for publisher in (self._estimate, self._external):
            publisher.undeclare()
        self._bulletin.close()


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
