"""Joint states on Zenoh: sessions, keys, publishing, and what arrived of what was sent.

| key | payload |
|---|---|
| `limo/<arm>/state/joints` | sensor_msgs/JointState |
| `limo/<arm>/torque/estimate` | limo_msgs/TorqueEstimate |
| `limo/<arm>/torque/external` | sensor_msgs/JointState whose effort is the external torque |
| `limo/<arm>/torque/known` | external torque as far as it is known, see `external_torque` |
| `limo/<arm>/contact` | JSON, ten times a second and when it changes |
| `limo/<arm>/event` | rcl_interfaces/Log |
| `limo/<arm>/status/service` | JSON, once a second and when its phase changes |
| `limo/<arm>/model/<verb>` | queryables of the service |
| `limo/<arm>/alive/<part>/<id>` | liveliness token |
| `limo/<arm>/seen/<part>` | queryable of drivers and services: the tokens that they see |

Payloads are CDR, see `messages`. Joint states are best effort and dropped on congestion, since an
old one is worth nothing; events and status are kept for those who come late.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import zenoh
import zenoh.ext

from limo_driver.errors import ConfigError, ConnectionLostError
from limo_driver.network.claims import Keys, Witness, claim, note_ends
from limo_driver.network.config import explained, read_config
from limo_driver.network.messages import Attachment, JointStateCodec
from limo_driver.runtime.processes import Closing
from limo_driver.types import JointState

KEPT_EVENTS: Final = 100  # for those who come late
_HEARTBEAT: Final = 1.0  # [s] after which a missed event is noticed
_REMEMBERED: Final = 4096  # lost samples that may still come late
_INSISTENT: Final = 100  # old samples in a row that are no longer taken for late ones
_NANOSECONDS: Final = 1e9


def open_session(
    connect: Sequence[str] | str = (),
    listen: Sequence[str] | str = (),
    config: Path | str | None = None,
) -> zenoh.Session:
    """Open a Zenoh session: a peer that finds others on its network, unless told otherwise.

    It tells drivers and services, when they ask, which others it sees.

    Args:
        connect: Endpoint or endpoints to reach, for example `tcp/192.168.1.2:7447`.
        listen: Endpoint or endpoints to be reached at.
        config: Zenoh's own configuration file (JSON5), for routers, TLS, users and access control;
            its paths are relative to it.

    Raises:
        ConfigError: The file or an endpoint cannot be used.
        ConnectionLostError: No session could be opened with it.
    """
    zenoh.try_init_log_from_env()  # RUST_LOG=zenoh=debug tells why a link is refused
    settings = zenoh.Config() if config is None else read_config(Path(config))
    connect, listen = ([x] if isinstance(x, str) else list(x) for x in (connect, listen))
    try:
        settings.insert_json5("timestamping/enabled", "true")  # caches need it
        for role, endpoints in (("connect", connect), ("listen", listen)):
            if endpoints:
                settings.insert_json5(f"{role}/endpoints", json.dumps(endpoints))
    except zenoh.ZError as error:
        raise ConfigError(
            f"endpoint {', '.join([*connect, *listen])}: {explained(error, located=False)}"
        ) from None
    try:
        session = _opened(settings)
    except zenoh.ZError as error:
        ends = ", ".join([*connect, *listen]) or "any peer"
        raise ConnectionLostError(f"no Zenoh session with {ends}: {explained(error)}") from None
    note_ends(session, settings)
    Witness(session, bystander=True)  # while it is open: others may meet over this one only
    return session


def _opened(settings: zenoh.Config) -> zenoh.Session:
    """Open a session, without shared memory on a computer that has none (no /dev/shm to write)."""
    try:
        return zenoh.open(settings)
    except zenoh.ZError as error:
        if " shm " not in str(error):
            raise
    settings.insert_json5("transport/shared_memory/enabled", "false")
    return zenoh.open(settings)


class JointStatePublisher(Closing):
    """Publishes the joint states of one arm as they are measured.

    Stamps are in Unix time but run with the robot's clock, so that they are as even as its cycle;
    the two are brought together once, by the first state.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.
        joint_names: Of the arm.
        also: Given every payload, with its sequence and Unix time [ns], to publish it elsewhere.

    Raises:
        ConfigError: Another driver publishes an arm of this name.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: str,
        joint_names: Sequence[str],
        also: Callable[[bytes, int, int], None] | None = None,
    ) -> None:
        keys = Keys(arm)
        self._witness = Witness(session)
        try:
            self._token = claim(session, keys, "driver")
        except BaseException:
            self._witness.close()
            raise
        self._codec = JointStateCodec(joint_names, frame_id=arm)
        self._publisher = declare_stream(session, keys.joints)
        self._source = zenoh.SourceInfo(self._publisher.id, 0)  # the number is in the attachment
        self._also = also
        self._origin: int | None = None  # [ns], of the robot's clock in Unix time
        self.published = 0

    def publish(self, state: JointState) -> None:
        """Send a state; it never waits for anyone."""
        source = round(state.time * _NANOSECONDS)
        if self._origin is None:
            self._origin = time.time_ns() - source
        attachment = Attachment(state.sequence, source, stale=state.stale, holding=state.holding)
        stamp = self._origin + source
        payload = self._codec.encode(stamp, state.position, state.velocity, state.torque)
        self._publisher.put(payload, attachment=attachment.encode(), source_info=self._source)
        if self._also is not None:
            self._also(payload, state.sequence, stamp)
        self.published += 1

    def close(self) -> None:
        """Take the arm off the network."""
        self._token.undeclare()
        self._witness.close()
        self._publisher.undeclare()


class Presence(Closing):
    """One part of some arms on the network: a session that opens and claims them meanwhile.

    Links take a second to come about, in which the caller can load what it is going to need.

    Args:
        arms: Their names in keys, none of which may have that part already.
        part: `driver` or `service`.
        connect, listen, config: Of the session, see `open_session`.
        joined: Given the session as soon as the arms are claimed, on a thread of its own.
    """

    def __init__(
        self,
        arms: Sequence[str],
        part: str,
        connect: Sequence[str] | str = (),
        listen: Sequence[str] | str = (),
        config: Path | str | None = None,
        joined: Callable[[zenoh.Session], None] | None = None,
    ) -> None:
        keys = [Keys(arm) for arm in sorted(arms)]  # two that want the same cannot stop each other
        self._open = ExitStack()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="limo-join")
        self._joined = self._thread.submit(self._join, keys, part, connect, listen, config, joined)

    def session(self) -> zenoh.Session:
        """Wait until the arms are claimed, and return the session.

        Raises:
            ConfigError: Another one is that part of an arm, or the network cannot be configured so.
            ConnectionLostError: No session could be opened.
        """
        return self._joined.result()

    def check(self) -> None:
        """Raise what `session` would, if that is known by now."""
        if self._joined.done():
            self._joined.result()

    def close(self) -> None:
        """Give the arms up and close the session, also where it was not waited for."""
        self._thread.shutdown()
        self._open.close()

    def _join(
        self,
        arms: Sequence[Keys],
        part: str,
        connect: Sequence[str] | str,
        listen: Sequence[str] | str,
        config: Path | str | None,
        joined: Callable[[zenoh.Session], None] | None,
    ) -> zenoh.Session:
        session = self._open.enter_context(open_session(connect, listen, config))
        self._open.enter_context(Witness(session))
        for keys in arms:
            self._open.callback(claim(session, keys, part).undeclare)
        if joined is not None:
            joined(session)
        return session


def is_alive(session: zenoh.Session, token: str, timeout: float = 0.5) -> bool:
    """Say whether a liveliness token is on the network, waiting at most `timeout` [s]."""
    return any(True for _ in session.liveliness().get(token, timeout=timeout))


def alive_arms(session: zenoh.Session, part: str, timeout: float = 0.5) -> list[str]:
    """Return the names of the arms that have a part, `driver` or `service`, on the network."""
    replies = session.liveliness().get(Keys.of_any().alive(part), timeout=timeout)
    found = (str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
    return sorted({key.split("/")[1] for key in found})


def declare_stream(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Return a publisher that drops messages rather than delay them."""
    return session.declare_publisher(
        key,
        encoding=zenoh.Encoding.APPLICATION_CDR,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
        reliability=zenoh.Reliability.BEST_EFFORT,
    )


def declare_history(
    session: zenoh.Session, key: str, kept: int = KEPT_EVENTS
) -> zenoh.ext.AdvancedPublisher:
    """Return a publisher whose last samples are there for those who come late."""
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        cache=zenoh.ext.CacheConfig(kept),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=_HEARTBEAT, sporadic_heartbeat=None
        ),
    )


def follow_history(
    session: zenoh.Session, key: str, callback: Callable[[zenoh.Sample], None]
) -> zenoh.ext.AdvancedSubscriber[None]:
    """Subscribe to what `declare_history` publishes, with what came before."""
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        callback,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        recovery=zenoh.ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
    )


class Arrivals:
    """Counts what is lost, duplicated or late among numbered samples.

    A sample is late when one that follows it came before; it was counted as lost then, and is
    taken off that count. Only samples in order are of use to who remembers. A number that goes
    back while the stamp goes on is a source that began anew. So is one whose samples are all old
    but follow each other, a hundred of them: its clock was set back, or what seemed newer was not
    its own.
    """

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter(received=0, lost=0, late=0, duplicated=0, restarts=0)
        self._sequence: int | None = None
        self._stamp = 0  # [ns]
        self._missing: dict[int, None] = {}  # may still come late; oldest first
        self._old = (0, 0)  # number and stamp of the latest one that was old
        self._in_a_row = 0  # old ones that follow each other

    def take(self, sequence: int, stamp: int) -> bool:
        """Count a sample and say whether it follows all that came before it.

        Args:
            sequence: Its number.
            stamp: When it was measured [ns].
        """
        last = self._sequence
        old = last is not None and sequence <= last and stamp <= self._stamp
        if old and not self._insists(sequence, stamp):
            if sequence in self._missing:
                del self._missing[sequence]
                self.counts["lost"] -= 1
                self.counts["late"] += 1
            else:
                self.counts["duplicated"] += 1
            return False
        if last is not None and sequence <= last:
            self.counts["restarts"] += 1
            self._missing.clear()
        elif last is not None:
            self._count_lost(last + 1, sequence)
        self._sequence, self._stamp, self._in_a_row = sequence, stamp, 0
        self.counts["received"] += 1
        return True

    def _insists(self, sequence: int, stamp: int) -> bool:
        follows = sequence > self._old[0] and stamp > self._old[1]
        self._old = sequence, stamp
        self._in_a_row = self._in_a_row + 1 if follows else 1
        return self._in_a_row > _INSISTENT

    def _count_lost(self, first: int, stop: int) -> None:
        if first == stop:
            return
        self.counts["lost"] += stop - first
        for sequence in range(max(first, stop - _REMEMBERED), stop):
            self._missing[sequence] = None
        while len(self._missing) > _REMEMBERED:
            del self._missing[next(iter(self._missing))]


def to_json(value: dict[str, Any]) -> bytes:
    """Return a status or an answer as it is sent."""
    return json.dumps(value, allow_nan=False).encode()
