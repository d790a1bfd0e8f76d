"""Be the only driver or service of an arm, also where links form a star.

Tokens of liveliness reach the sessions that are linked to each other, and no peer passes them on:
in a star, the ends do not see each other. So every driver and service tells, when asked under
`limo/<arm>/seen/<part>`, which tokens it sees; who claims a name asks all that it is linked to.
"""

from __future__ import annotations

import json
import time
from threading import Lock
from typing import Final

import zenoh

from limo_driver.closing import Closing
from limo_driver.errors import ConfigError
from limo_driver.network.keys import Keys
from limo_driver.network.limits import PeerLimits

LINKING: Final = 0.5  # [s] in which those who are there are linked
_MOST_TOKENS: Final = 1000  # that are remembered, and told at once
_ASKED: Final = 200  # queries of a peer that are answered in a second
_LONGEST: Final = 1 << 18  # bytes of an answer


class Witness(Closing):
    """Tells who asks which drivers and services a session sees.

    Args:
        session: Open Zenoh session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._lock, self._tokens = Lock(), dict[str, None]()
        self._limits = PeerLimits(_ASKED, _ASKED)
        every = Keys.of_any()
        self._subscriber = session.liveliness().declare_subscriber(
            every.alive("*"), self._note, history=True
        )
        self._queryable = session.declare_queryable(every.seen(), self._tell)

    def close(self) -> None:
        """Tell no more."""
        self._queryable.undeclare()
        self._subscriber.undeclare()

    def _note(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.DELETE:
                self._tokens.pop(token, None)
            elif len(self._tokens) < _MOST_TOKENS:
                self._tokens[token] = None

    def _tell(self, query: zenoh.Query) -> None:
        info = query.source_info
        if not self._limits.admits("" if info is None else str(info.source_id)):
            query.drop()
            return
        with query, self._lock:
            asked = str(query.key_expr)
            arm, _, part = asked.rpartition("/seen/")
            wanted = f"{arm}/alive/{part}/"
            seen = [token for token in self._tokens if token.startswith(wanted)]
            query.reply(query.key_expr, json.dumps(seen).encode())


def claim(session: zenoh.Session, keys: Keys, part: str) -> zenoh.LivelinessToken:
    """Be the only driver or service of an arm, until the token that is returned is undeclared.

    Those who are asked are the sessions that this one is linked to, and all behind a router.

    Whoever was there before stays, whatever the clocks say; of two that begin together, the one
    that began earlier. Links to others need time to come about, so it takes a second.

    Raises:
        ConfigError: Another one is there.
    """
    identity = f"{time.time_ns()}-{session.zid()}"
    own = keys.alive(part, identity)
    if not _others(session, keys, part, own):
        token = session.liveliness().declare_token(own)
        if not any(other < own for other in _others(session, keys, part, own)):
            return token
        token.undeclare()
    raise ConfigError(
        f"another {part} of an arm called {keys.arm!r} is on the network already; give this one "
        "another name, or stop that one"
    )


def _others(session: zenoh.Session, keys: Keys, part: str, own: str) -> set[str]:
    """Return the other tokens that are seen while links come about, and when they have."""
    seen: set[str] = set()
    ends = time.monotonic() + LINKING
    while True:
        linked = time.monotonic() >= ends
        replies = session.liveliness().get(keys.alive(part), timeout=LINKING)
        seen |= {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        seen |= _told(session, keys, part)
        if linked:
            return seen - {own}
        time.sleep(LINKING / 10)


def _told(session: zenoh.Session, keys: Keys, part: str) -> set[str]:
    """Return the tokens that others see."""
    told: set[str] = set()
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
        if isinstance(tokens, list):
            names = (token for token in tokens if isinstance(token, str))
            told |= {token for token in names if token.startswith(prefix)}
    return told
