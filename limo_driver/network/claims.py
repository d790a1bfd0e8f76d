"""Names on the network: the keys of an arm, who may claim one, and how often others may ask.

Be the only driver or service of an arm, also where links form a star.

Tokens of liveliness reach the sessions that are linked to each other, and no peer passes them on:
in a star, the ends do not see each other. So every driver and service tells, when asked under
`limo/<arm>/seen/<part>`, which tokens it sees, and so does every other session of limo, as a
bystander; who claims a name asks all that it is linked to, and gets none while a driver or service
does not answer, as in a flood of queries. Nor does whoever reaches for a peer that tells nothing,
as one that is not limo's, and finds nobody by itself: others may be behind that one.

Answer queries only so often, however many come.

Zenoh does not say who asks, so nobody can be given a share of their own. What can be kept is the
stream: queries wait in a ring, from which Zenoh's own threads drop the oldest, and one thread takes
as many of them as may be answered. The rest of a flood is dropped without a line of Python. Where
an answer costs next to nothing, all may be answered, and a long ring lets them: a thread that waits
for its turn on the interpreter finds a thousand queries then, and answers them in one go, for half
of what it costs to be woken for each.
"""

from __future__ import annotations

import atexit
import json
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Final, Self, cast
from weakref import WeakSet

import zenoh

from limo_driver.errors import ConfigError
from limo_driver.runtime.processes import Closing

LINKING: Final = 0.5  # [s] in which those who are there are linked
PATIENCE: Final = 5.0  # [s] in which those who are linked tell whom they see
_MOST_TOKENS: Final = 1000  # that are remembered, and told at once
_ASKED, _AT_ONCE = 200.0, 50  # queries that are answered: in a second, and together
_LONGEST: Final = 1 << 18  # bytes of an answer
_MOST_SESSIONS: Final = 100  # of this process, whose ends are remembered
_BYSTANDER: Final = "bystander"  # of an answer, what one sees that is no driver or service
_ANY: Final = "*"
_ends: Final[dict[str, frozenset[str]]] = {}  # that a session reaches and no others, by Zenoh id
_IDENTITY: Final = re.compile(r"/[0-9]+-([0-9a-f]+)$")  # of a token: when it was made, and by whom
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]+")


class Witness(Closing):
    """Tells who asks which drivers and services a session sees.

    Args:
        session: Open Zenoh session.
        bystander: It is neither, and answers for others who are linked to it.
    """

    def __init__(self, session: zenoh.Session, *, bystander: bool = False) -> None:
        self._bystander = bystander
        self._lock, self._tokens = Lock(), dict[str, None]()
        every = Keys.of_any()
        self._subscriber = session.liveliness().declare_subscriber(
            every.alive("*"), self._note, history=True
        )
        self._queryable = PacedQueryable(session, every.seen(), self._tell, _ASKED, _AT_ONCE)

    def close(self) -> None:
        """Tell no more."""
        self._queryable.close()
        self._subscriber.undeclare()

    def _note(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._tokens.pop(token, None)
            elif len(self._tokens) < _MOST_TOKENS:
                self._tokens[token] = None

    def _tell(self, query: zenoh.Query) -> None:
        with self._lock:
            tokens = list(self._tokens)
        arm, _, part = str(query.key_expr).rpartition("/seen/")
        seen = [token for token in tokens if token.startswith(f"{arm}/alive/{part}/")]
        answer = {_BYSTANDER: seen} if self._bystander else seen
        query.reply(query.key_expr, json.dumps(answer).encode())


def note_ends(session: zenoh.Session, settings: zenoh.Config) -> None:
    """Note whom a session was told to reach, where it finds nobody else.

    Args:
        session: Open.
        settings: That it was opened with.
    """

    def setting(key: str) -> object:
        return json.loads(settings.get_json(key))

    found = [setting(f"scouting/{how}/enabled") is not False for how in ("gossip", "multicast")]
    if any(found) or setting("mode") not in {None, "peer"}:
        return
    ends: object = setting("connect/endpoints")
    while isinstance(ends, dict):  # by mode
        ends = cast("dict[str, object]", ends).get("peer")
    while len(_ends) >= _MOST_SESSIONS:
        del _ends[next(iter(_ends))]
    names = map(str, cast("list[object]", ends)) if isinstance(ends, list) else ()
    _ends[str(session.zid())] = frozenset(map(_port, names))


def claim(session: zenoh.Session, keys: Keys, part: str) -> zenoh.LivelinessToken:
    """Be the only driver or service of an arm, until the token that is returned is undeclared.

    Those who are asked are the sessions that this one is linked to, and all behind a router. One
    that this reaches for, in a network in which nobody is found otherwise, has to answer.

    Whoever was there before stays, whatever the clocks say; of two that begin together, the one
    that began earlier. Links to others need time to come about, so it takes a second.

    Raises:
        ConfigError: Another one is there, or somebody linked does not tell whom it sees.
    """
    identity = f"{time.time_ns()}-{session.zid()}"
    own = keys.alive(part, identity)
    if not _others(session, keys, part, own):
        token = session.liveliness().declare_token(own)
        try:
            if not any(other < own for other in _others(session, keys, part, own)):
                return token
        except ConfigError:
            token.undeclare()
            raise
        token.undeclare()
    raise ConfigError(
        f"another {part} of an arm called {keys.arm!r} is on the network already; give this one "
        "another name, or stop that one"
    )


def _others(session: zenoh.Session, keys: Keys, part: str, own: str) -> set[str]:
    """Return the other tokens that are seen while links come about, and when they have.

    Raises:
        ConfigError: Somebody linked does not tell whom it sees.
    """
    seen: set[str] = set()
    began = time.monotonic()
    while True:
        linked = time.monotonic() >= began + LINKING
        replies = session.liveliness().get(Keys.of_any().alive(_ANY), timeout=LINKING)
        alive = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        heard, witnesses, bystanders = _heard(session, keys, part)
        seen |= heard | {token for token in alive if token.startswith(keys.alive(part, ""))}
        silent = {zid for token in alive if (zid := _zid(token))} - witnesses - {str(session.zid())}
        hubs = _reached(session) - witnesses - bystanders
        others = seen - {own}
        if linked and (not (silent or hubs) or any(other < own for other in others)):
            return others
        if time.monotonic() >= began + PATIENCE and not silent:
            raise ConfigError(
                f"whether another {part} of an arm called {keys.arm!r} is on the network cannot be "
                f"told: this one is linked to a peer that does not say whom it sees (Zenoh id "
                f"{', '.join(sorted(hubs))}), and others behind it are not found; let it be a "
                'router (mode: "router"), or link drivers and services to each other'
            )
        if time.monotonic() >= began + PATIENCE:
            raise ConfigError(
                f"whether another {part} of an arm called {keys.arm!r} is on the network cannot be "
                f"told: {len(silent)} of the drivers and services there did not answer within "
                f"{PATIENCE:g} s (Zenoh id {', '.join(sorted(silent))}); try again once they are "
                "not asked by others all the time"
            )
        time.sleep(LINKING / 10)


def _reached(session: zenoh.Session) -> set[str]:
    """Return the Zenoh ids of linked peers behind which others may be that are not found."""
    ends, peers = _ends.get(str(session.zid())), set(map(str, session.info.peers_zid()))
    if not ends:
        return set()
    return {
        str(link.zid)
        for link in session.info.links()
        if str(link.zid) in peers and _port(str(link.dst)) in ends
    }


def _port(end: str) -> str:
    """Return what an endpoint and the address of a link to it have in common."""
    return end.partition("?")[0].partition("#")[0].rpartition(":")[2]


def _zid(token: str) -> str:
    """Return the Zenoh id of the session that a token is of; empty if that made none like ours."""
    found = _IDENTITY.search(token)
    return found[1] if found else ""


def _heard(session: zenoh.Session, keys: Keys, part: str) -> tuple[set[str], set[str], set[str]]:
    """Return the tokens that others see, and who answered: Zenoh ids, and those of bystanders."""
    heard: set[str] = set()
    witnesses: set[str] = set()
    bystanders: set[str] = set()
    prefix = keys.alive(part, "")
    for reply in session.get(
        keys.seen(part), target=zenoh.QueryTarget.ALL, timeout=LINKING,
        consolidation=zenoh.ConsolidationMode.NONE,
    ):  # fmt: skip
        data = b"" if reply.ok is None else reply.ok.payload.to_bytes()
        try:
            tokens: object = json.loads(data) if 0 < len(data) <= _LONGEST else None
        except (ValueError, RecursionError):
            continue
        teller = witnesses
        if isinstance(tokens, dict):
            tokens, teller = cast("dict[str, object]", tokens).get(_BYSTANDER), bystanders
        if isinstance(tokens, list):
            names = (token for token in tokens if isinstance(token, str))
            heard |= {token for token in names if token.startswith(prefix)}
            if reply.replier_id is not None:
                teller.add(str(reply.replier_id.zid))
    return heard, witnesses, bystanders


@dataclass(frozen=True)
class Keys:
    """Keys of one arm on the network.

    Raises:
        ConfigError: The name cannot be part of a key.
    """

    arm: str

    def __post_init__(self) -> None:
        if self.arm != _ANY and not _NAME.fullmatch(self.arm):
            raise ConfigError(
                f"the arm's name is {self.arm!r}, expected letters, digits, '_', '-' and '.'"
            )

    @classmethod
    def of_any(cls) -> Self:
        """Return key expressions that are those of every arm."""
        return cls(_ANY)

    @property
    def root(self) -> str:
        """Prefix of all keys."""
        return f"limo/{self.arm}"

    @property
    def joints(self) -> str:
        """Measured joint states."""
        return f"{self.root}/state/joints"

    @property
    def estimate(self) -> str:
        """Torque estimates."""
        return f"{self.root}/torque/estimate"

    @property
    def external(self) -> str:
        """External torques, measured less estimated: -Jᵀ F of what pushes the arm."""
        return f"{self.root}/torque/external"

    @property
    def known(self) -> str:
        """External torques as far as they are known."""
        return f"{self.root}/torque/known"

    @property
    def contact(self) -> str:
        """Whether something leans on each joint, or nobody knows."""
        return f"{self.root}/contact"

    @property
    def event(self) -> str:
        """Contacts, drift, swaps of models, and what else happens."""
        return f"{self.root}/event"

    def status(self, part: str) -> str:
        """Condition of a part: of the `service`."""
        return f"{self.root}/status/{part}"

    def alive(self, part: str, identity: str = _ANY) -> str:
        """Liveliness token of a part, `driver` or `service`; of any one that is it by default."""
        return f"{self.root}/alive/{part}/{identity}"

    def seen(self, part: str = _ANY) -> str:
        """Queryable of the tokens of a part that are seen from where it is answered."""
        return f"{self.root}/seen/{part}"

    def model(self, verb: str) -> str:
        """Queryable of the service's models."""
        return f"{self.root}/model/{verb}"


class RateLimit:
    """Allows so many actions a second, and some at once.

    Args:
        rate: Actions in the long run [1/s].
        burst: Those that may come together.
        clock: Tells the time [s].
    """

    def __init__(
        self, rate: float, burst: int, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._rate, self._burst, self._clock = rate, float(burst), clock
        self._left, self._then = self._burst, clock()

    def take(self) -> float:
        """Take the next action; return how long it has to wait [s], 0 if it need not."""
        now = self._clock()
        self._left = min(self._left + (now - self._then) * self._rate, self._burst) - 1.0
        self._then = now
        return max(0.0, -self._left / self._rate)


class PacedQueryable(Closing):
    """Answers queries on a key, one after the other, no more often than it may.

    Args:
        session: Open Zenoh session.
        key: Key expression of the queries.
        answer: Called with each query that is answered, on a thread of its own.
        rate: Queries that are answered in the long run [1/s].
        burst: Those that may come together, and wait; older ones are dropped, not answered late.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        answer: Callable[[zenoh.Query], None],
        rate: float,
        burst: int,
    ) -> None:
        self._limit, self._answer = RateLimit(rate, burst), answer
        self._closed = threading.Event()
        self._queryable = session.declare_queryable(key, zenoh.handlers.RingChannel(burst))
        self._thread = threading.Thread(
            target=self._serve, args=(self._queryable.handler,), name="limo-queries", daemon=True
        )
        self._thread.start()
        _answering.add(self)

    def close(self) -> None:
        """Answer no more; what is being answered is told to its end."""
        if self._closed.is_set():
            return
        self._closed.set()
        try:
            self._queryable.undeclare()
        finally:
            self._thread.join()

    def _serve(self, queries: zenoh.Handler[zenoh.Query]) -> None:
        while not self._closed.is_set():
            if (pause := self._limit.take()) and self._closed.wait(pause):  # seldom
                return
            try:
                query = queries.recv()
            except zenoh.ZError:  # undeclared
                return
            with query:
                self._answer(query)


_answering: Final[WeakSet[PacedQueryable]] = WeakSet()


@atexit.register
def _end_all() -> None:
    """Join the threads that answer, whose session was closed.

    Python ends a thread that comes back from Zenoh while it shuts down, and Zenoh's code, which
    cannot be left so, aborts the process.
    """
    for queryable in list(_answering):
        with suppress(zenoh.ZError):  # went with its session
            queryable.close()
