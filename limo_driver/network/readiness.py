"""In which phase the service of an arm is, and how to wait for one.

```python
with open_session() as session:
    wait_until_serving(session, "iiwa14", timeout=60.0)
```

A service says `loading`, `compiling`, `waiting` (for joint states), `preparing` and `serving`, in
this order, on its status key, which is kept for those who come late. Its name is on the network
before it can answer anything, so a name says nothing about that.

Client for the model versions of a running service: list, load, promote, roll back, retrain.
"""

from __future__ import annotations

import json
import threading
import time
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, Self

from limo_driver.errors import (
    ConfigError,
    ConnectionLostError,
    ModelStoreError,
    ServiceNotReadyError,
    WireFormatError,
)
from limo_driver.network.messages import decode_torque_estimate
from limo_driver.network.streaming import Keys, alive_arms, follow_history, is_alive, to_json
from limo_driver.runtime.processes import Closing

if TYPE_CHECKING:
    import zenoh

PATIENCE: Final = 60.0  # [s] for a service to serve, if nothing else is said
_LONGEST: Final = 65536  # bytes of a status


class ServicePhase(StrEnum):
    """Phase of an arm's service."""

    LOADING = "loading"  # models and physics
    COMPILING = "compiling"  # what the first estimate needs, or reading it from the cache
    WAITING = "waiting"  # for joint states
    PREPARING = "preparing"  # their rate is known, and what answers them is loaded
    SERVING = "serving"  # every joint state is answered
    REFUSED = "refused"  # joint states come, and cannot be served; it tries again
    SILENT = "silent"  # joint states came, and come no more

    @classmethod
    def named(cls, name: str) -> Self:
        """Return the phase of a name that can be waited for.

        Raises:
            ConfigError: There is none; names those that there are.
        """
        if name not in _RANK:
            raise ConfigError(f"a service is never {name!r}, expected {', '.join(_RANK)}")
        return cls(name)

    def has_reached(self, phase: ServicePhase) -> bool:
        """Say whether a service in this phase is as far as `phase`, or further."""
        # one that refuses states or hears none any more is ready for others
        return _RANK.get(self, _RANK[ServicePhase.WAITING]) >= _RANK[phase]


_RANK: Final = {phase: rank for rank, phase in enumerate(list(ServicePhase)[:5])}


@dataclass(frozen=True)
class HeardService:
    """Latest status of a service."""

    arm: str
    phase: ServicePhase
    state: str  # the phase in words, with what there is to say
    heard: float  # of the monotonic clock [s]


class ServiceWatch(Closing):
    """Hears how far the service of an arm is, from its last word before on.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys; `*` for any.

    Raises:
        ConfigError: The name cannot be part of a key.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._keys = session, Keys(arm)
        self._heard: dict[str, HeardService] = {}
        self._changed = threading.Condition()
        status = self._keys.status("service")
        self._subscriber = follow_history(session, status, self._take)

    def wait(
        self, until: ServicePhase | str = ServicePhase.SERVING, timeout: float = PATIENCE
    ) -> HeardService:
        """Wait until a service has reached the phase `until`, and return its status.

        Args:
            until: A phase; every later one will do, too.
            timeout: Longest wait [s].

        Raises:
            ServiceNotReadyError: It was not in time; says who was heard last, and what it said.
            ConfigError: No such phase, or `timeout` is not above 0.
        """
        phase = ServicePhase.named(until)
        require_wait("timeout", timeout)
        ends = time.monotonic() + timeout
        with self._changed:
            while (found := self._first(phase)) is None:
                left = ends - time.monotonic()
                if left <= 0:
                    raise self.error(phase, timeout)
                self._changed.wait(min(left, threading.TIMEOUT_MAX))
        return found

    def error(self, until: ServicePhase, waited: float) -> ServiceNotReadyError:
        """Return why a service did not get as far as `until` within `waited` [s]."""
        return ServiceNotReadyError(self._keys.arm, until.value, waited, self._last_word())

    def close(self) -> None:
        """Hear no more."""
        self._subscriber.undeclare()

    def _first(self, phase: ServicePhase) -> HeardService | None:
        return next((one for one in self._heard.values() if one.phase.has_reached(phase)), None)

    def _take(self, sample: zenoh.Sample) -> None:
        if (latest := _read(sample)) is None:
            return
        with self._changed:
            self._heard[latest.arm] = latest
            self._changed.notify_all()

    def _last_word(self) -> str:
        """Return who was heard last and what it said; empty if nobody was heard."""
        if not self._heard:
            if is_alive(self._session, self._keys.alive("service")):
                return "its name is on the network, but it said nothing yet"
            others = alive_arms(self._session, "service")
            return f"there are services of {', '.join(map(repr, others))} only" if others else ""
        last = max(self._heard.values(), key=lambda one: one.heard)
        ago = time.monotonic() - last.heard
        text = f"the service of {last.arm} said {last.state!r} {ago:.1f} s ago"
        if is_alive(self._session, Keys(last.arm).alive("service")):
            return text
        return f"{text}, and is gone since"


def wait_until_serving(
    session: zenoh.Session,
    arm: str,
    *,
    until: ServicePhase | str = ServicePhase.SERVING,
    timeout: float = PATIENCE,
) -> HeardService:
    """Wait until the service of an arm serves, or is as far as another phase.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys; `*` for any.
        until: A phase; every later one will do, too. A service without joint states comes as far
            as `waiting`.
        timeout: Longest wait [s].

    Returns:
        What the service said.

    Raises:
        ServiceNotReadyError: It was not in time; says who was heard last, and what it said.
        ConfigError: The name cannot be part of a key, no such phase, or `timeout` is not above 0.
    """
    with ServiceWatch(session, arm) as watch:
        return watch.wait(until, timeout)


class FirstEstimate(Closing):
    """Says whether estimates of an arm's torque come, for `Playback.start_when`.

    Those in which the filter of the motion is still filling do not count.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.
        timeout: Longest wait, from when it is asked first [s].

    Raises:
        ConfigError: The name cannot be part of a key, or `timeout` is not above 0.
    """

    def __init__(self, session: zenoh.Session, arm: str, timeout: float) -> None:
        require_wait("timeout", timeout)
        self._timeout, self._ends = timeout, float("inf")
        self._asked = self._came = False
        self._watch: ServiceWatch | None = ServiceWatch(session, arm)
        self._estimates = session.declare_subscriber(Keys(arm).estimate, self._take)

    def __call__(self) -> bool:
        """Say whether estimates come.

        Raises:
            ServiceNotReadyError: None came in time; says who was heard last, and what it said.
        """
        if self._watch is None:
            return True
        if not self._asked:
            self._asked, self._ends = True, time.monotonic() + self._timeout
        if self._came:
            self.close()  # takes time, so that the arm should not begin to move in this cycle
        elif time.monotonic() >= self._ends:
            raise self._watch.error(ServicePhase.SERVING, self._timeout)
        return False

    def close(self) -> None:
        """Hear no more."""
        if self._watch is not None:
            self._estimates.undeclare()
            self._watch.close()
            self._watch = None

    def _take(self, sample: zenoh.Sample) -> None:
        if self._came:
            return
        try:
            self._came = not decode_torque_estimate(sample.payload.to_bytes()).reset
        except WireFormatError:
            return


def require_wait(name: str, seconds: float) -> None:
    """Refuse a longest wait that is none.

    Raises:
        ConfigError: It is not above 0.
    """
    if not seconds > 0:
        raise ConfigError(f"{name} is {seconds:g} s, expected above 0")


def _read(sample: zenoh.Sample) -> HeardService | None:
    """Return what a service said; None where that is nothing of one arm's service."""
    match str(sample.key_expr).split("/"):
        case ["limo", arm, *_] if "*" not in arm:
            data = sample.payload.to_bytes()
        case _:
            return None
    try:
        values = json.loads(data if len(data) <= _LONGEST else "{}")
        phase = ServicePhase(values["phase"])
        return HeardService(arm, phase, str(values["state"]), time.monotonic())
    except (LookupError, RecursionError, TypeError, ValueError):
        return None


APPEARING: Final = 3.0  # [s] in which a service that is there is found
STARTING: Final = 10.0  # [s] that one may need from its name to its first answer
VETTING: Final = 180.0  # [s] for a version to be vetted, loaded and given its memory
_INDEX: Final = 10.0  # [s]


class ModelClient:
    """Asks the service of one arm which models it has, and to let another one serve.

    Args:
        session: Open Zenoh session.
        arm: Name of the arm in keys.

    Raises:
        ConfigError: The name cannot be part of a key.
    """

    def __init__(self, session: zenoh.Session, arm: str) -> None:
        self._session, self._keys = session, Keys(arm)

    def index(self) -> dict[str, Any]:
        """Return versions, aliases, and which version serves.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: The service cannot say, and why.
        """
        return self._ask("index", {}, _INDEX)

    def load(self, version: str) -> dict[str, Any]:
        """Let a version serve until the service ends; returns which, and which one did before.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: The version is refused, and why; the old one serves on.
        """
        return self._ask("load", {"version": version}, VETTING)

    def promote(self, version: str, reason: str) -> dict[str, Any]:
        """Let a version serve, and make it the champion.

        Raises:
            ConnectionLostError, ModelStoreError: As for `load`.
        """
        return self._ask("promote", {"version": version, "reason": reason}, VETTING)

    def rollback(self, reason: str) -> dict[str, Any]:
        """Let the champion before serve again, and make it the champion.

        Raises:
            ConnectionLostError, ModelStoreError: As for `load`, or there is none before.
        """
        return self._ask("rollback", {"reason": reason}, VETTING)

    def retrain(self, reason: str) -> dict[str, Any]:
        """Train a challenger from the newest logs; returns the stage of retraining.

        Raises:
            ConnectionLostError: No service answers.
            ModelStoreError: It does not retrain, or cannot now, and why.
        """
        return self._ask("retrain", {"reason": reason}, _INDEX)

    def _ask(self, verb: str, asked: dict[str, str], timeout: float) -> dict[str, Any]:
        key, arm = self._keys.model(verb), self._keys.arm
        if not self._found():
            raise ConnectionLostError(
                f"no service of arm {arm!r} is on the network; start one with `limo serve`, or say "
                "where it is with `connect` or `config`"
            )
        ends = time.monotonic() + STARTING
        while True:
            for reply in self._session.get(key, payload=to_json(asked), timeout=timeout):
                if reply.ok is not None:
                    try:
                        answer: object = json.loads(reply.ok.payload.to_bytes())
                    except (ValueError, RecursionError):
                        answer = None
                    if not isinstance(answer, dict):
                        raise ModelStoreError(f"{key}: the answer is no JSON object")
                    return answer
                if reply.err is not None:
                    raise ModelStoreError(_refusal(key, reply.err.payload.to_bytes(), timeout))
            if time.monotonic() >= ends:  # a service has its name before it can answer
                raise ConnectionLostError(
                    f"the service of arm {arm!r} is on the network, but nobody answered {key} for "
                    f"{STARTING:g} s; it may still be starting, ask again"
                )
            time.sleep(0.1)

    def _found(self) -> bool:
        ends = time.monotonic() + APPEARING
        while not is_alive(self._session, self._keys.alive("service")):
            if time.monotonic() >= ends:
                return False
            time.sleep(0.1)
        return True


def _refusal(key: str, payload: bytes, timeout: float) -> str:
    """Return why a service refused; Zenoh itself answers a timeout in plain words."""
    try:
        content: object = json.loads(payload)
    except (ValueError, RecursionError):
        content = None
    if isinstance(content, dict) and isinstance(content.get("error"), str):
        return content["error"]
    return f"{key}: no answer within {timeout:g} s ({payload[:80]!r})"
