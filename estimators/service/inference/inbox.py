"""What comes from the network and what goes there and to the log: states in, estimates out.

States that wait to be answered: few, of one source, however many others send.

What comes waits in a ring in Rust, which a flood fills. Between any two answers all of it is taken
out and sorted: of the source that is followed, the latest few wait on, and the oldest of them go;
states of others are counted, and nothing of them is read.

Publish and log the results of one arm.

The status says whether the log is being written; an event tells when writing stops, and it is
tried again.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from limo_driver.network.messages import JOINT_STATE, LOG, TORQUE_ESTIMATE, Event, Level
from limo_driver.network.streaming import declare_history, declare_stream, to_json

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh
    import zenoh.ext

    from limo_driver.logs.mcap_log import McapLog
    from limo_driver.network.contact_state import ContactState
    from limo_driver.network.external_torque import ExternalTorque
    from limo_driver.network.readiness import ServicePhase
    from limo_driver.network.streaming import Keys

RING: Final = 4096  # samples of anybody
WAITING: Final = 128  # states, answered in less time than a few take; older ones are lost
_SILENT: Final = 1.0  # [s] after which another source is followed
_DEAD: Final = 5.0  # [s] without states, after which it is told
PAUSE: Final = 60.0  # [s] before a log that stopped is begun again


class Inbox:
    """The next state to be answered.

    Args:
        samples: Handler of a subscription, with a ring of `RING`.
        foreign: Says of a source, and counts, that it is not the one that is followed.
    """

    def __init__(
        self, samples: zenoh.Handler[zenoh.Sample], foreign: Callable[[str], bool]
    ) -> None:
        self._samples, self._foreign = samples, foreign
        self._waiting: deque[tuple[zenoh.Sample, str]] = deque(maxlen=WAITING)

    def next(self) -> tuple[zenoh.Sample, str]:
        """Wait for a state, and return the oldest of those that still wait, and its source.

        Raises:
            zenoh.ZError: The subscription has ended.
        """
        waiting, samples = self._waiting, self._samples
        while True:
            if not waiting:
                self._sort(samples.recv())
            for _ in range(RING):  # a flood may come as fast as it is read
                if (sample := samples.try_recv()) is None:
                    break
                self._sort(sample)
            if waiting:
                return waiting.popleft()

    def _sort(self, sample: zenoh.Sample) -> None:
        info = sample.source_info  # each time that it is asked for, it is made anew
        source = "" if info is None else str(info.source_id)
        if not self._foreign(source):
            self._waiting.append((sample, source))


class FollowedSource:
    """One source of joint states at a time, until it is silent."""

    def __init__(self) -> None:
        self._source, self._heard = "", -float("inf")  # and when it last sent [s]
        self._other: str | None = None  # that is not followed
        self._told = False

    def is_foreign(self, source: str) -> bool:
        """Say whether a state is of another source than the one that is followed."""
        if source == self._source or time.monotonic() - self._heard > _SILENT:
            return False
        self._other = source
        return True

    def follow(self, source: str) -> str | None:
        """Keep to the source of a state.

        Returns:
            What to tell, once, if another one sends at the same time.
        """
        if source != self._source:
            self._source, self._other, self._told = source, None, False
        self._heard = time.monotonic()
        if self._other is None or self._told:
            return None
        self._told = True
        return (
            f"two sources send joint states; {source or 'one'} is answered, "
            f"{self._other or 'the other'} is not"
        )


class StateSilence:
    """Time since joint states came."""

    def __init__(self) -> None:
        self._arrived, self._arrived_at = -1, 0.0  # states, and when the last ones were seen [s]
        self.silent = False  # for so long that it is told

    def look(self, arrived: int, *, answering: bool) -> bool:
        """Look how many states arrived in all, and say whether silence began or ended."""
        now = time.monotonic()
        if arrived != self._arrived or not answering:
            self._arrived, self._arrived_at = arrived, now
        before, self.silent = self.silent, now - self._arrived_at > _DEAD
        return self.silent != before

    @property
    def lasts(self) -> float:
        """Time since states were last seen [s]."""
        return time.monotonic() - self._arrived_at

    @property
    def limit(self) -> float:
        """Time without states after which silence is reported [s]."""
        return _DEAD


class NetworkOutlet:
    """Publishes estimates, external torque, events and status of one arm, and logs them.

    None of its methods blocks; `external_wanted` says whether anyone listens to external torques,
    and `known_wanted` to what is known of them.

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
        self._contact = declare_stream(session, keys.contact)
        self._known = declare_stream(session, keys.known)
        self.external_wanted = self.known_wanted = False
        self._matching = (
            self._external.declare_matching_listener(self._match_external),
            self._known.declare_matching_listener(self._match_known),
        )

    def estimate(self, payload: bytes, attachment: bytes, stamp_ns: int) -> None:
        """Publish and log a torque estimate."""
        self._estimate.put(payload, attachment=attachment)
        self.log(self._keys.estimate, TORQUE_ESTIMATE, payload, stamp_ns)

    def external(self, payload: bytes, attachment: bytes) -> None:
        """Publish an external torque, -Jᵀ F of what pushes the arm; the log has it in estimates."""
        self._external.put(payload, attachment=attachment)

    def known(self, news: ExternalTorque, attachment: bytes) -> None:
        """Publish an external torque as far as it is known."""
        self._known.put(news.encode(), attachment=attachment)

    def contact(self, state: ContactState) -> None:
        """Publish what is known of contacts."""
        self._contact.put(state.encode())

    def state(self, payload: bytes, stamp_ns: int, sequence: int) -> None:
        """Log a joint state as it came."""
        self.log(self._keys.joints, JOINT_STATE, payload, stamp_ns, sequence)

    def _match_external(self, status: zenoh.MatchingStatus) -> None:
        self.external_wanted = bool(status.matching)

    def _match_known(self, status: zenoh.MatchingStatus) -> None:
        self.known_wanted = bool(status.matching)

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
        streams = self._estimate, self._external, self._known, self._contact
        for declared in (*self._matching, *streams):
            declared.undeclare()
        self._bulletin.close()


class LogWatch:
    """Looks after the log of one arm, each time that its status is taken.

    Args:
        log: That may stop: a full disk, for example.
        outlet: Told when it does, and when it goes on.
    """

    def __init__(self, log: McapLog, outlet: NetworkOutlet) -> None:
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
