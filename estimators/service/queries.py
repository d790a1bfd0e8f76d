"""Answer queries about the models of a running service, verb by verb."""

from __future__ import annotations

import json
import logging
import math
import time
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import LimoError
from limo_driver.network.limits import PacedQueryable
from limo_driver.network.streaming import to_json

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from estimators.service.roles import ModelChanges

_log = logging.getLogger("limo")
_LONGEST: Final = 4096  # bytes of a query
_ASKED, _AT_ONCE = 50.0, 100  # queries of a verb that are answered: in a second, and together
_READ, _READ_AT_ONCE = 5000.0, 1000  # of one that changes nothing, whose answer is kept
_KEPT: Final = 0.05  # [s] for which that answer stands


class ModelQueries:
    """Answers queries on `limo/<arm>/model/<verb>`, those of each verb one after the other.

    A query's payload is a JSON object, `{"version": "3", "reason": "..."}` where that is needed;
    the answer is one, too, or an error that says why not. Of a flood of queries that change models,
    most are not answered, so that it does not hold the stream; of those that ask for the index,
    whose answer is made twenty times a second at most, nearly all are.

    Args:
        session: Open Zenoh session.
        server: Whose models.
    """

    def __init__(self, session: zenoh.Session, server: ModelChanges) -> None:
        verbs: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "load": lambda asked: server.load(_version(asked)),
            "promote": lambda asked: server.promote(_version(asked), _reason(asked)),
            "rollback": lambda asked: server.rollback(_reason(asked)),
            "retrain": lambda asked: server.retrain(_reason(asked)),
        }
        index = _Kept(server.index)
        self._queryables = [
            PacedQueryable(session, server.keys.model("index"), index.answer, _READ, _READ_AT_ONCE)
        ]
        self._queryables += [
            PacedQueryable(
                session,
                server.keys.model(verb),
                lambda query, act=act: _answer(query, act),
                _ASKED,
                _AT_ONCE,
            )
            for verb, act in verbs.items()
        ]

    def close(self) -> None:
        """Answer no more."""
        for queryable in self._queryables:
            queryable.close()


class _Kept:
    """Answers queries by what was read a moment ago: a flood of them reads no store.

    Args:
        read: Returns the answer.
        clock: Tells the time [s].
    """

    def __init__(
        self, read: Callable[[], dict[str, Any]], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._read, self._clock, self._made = read, clock, -math.inf
        self._kept = b""

    def answer(self, query: zenoh.Query) -> None:
        """Answer a query, whatever it says."""
        if (now := self._clock()) < self._made + _KEPT and query.payload is None:
            query.reply(query.key_expr, self._kept)
            return
        _answer(query, self._fresh)
        self._made = now if self._kept else -math.inf

    def _fresh(self, _: dict[str, Any]) -> dict[str, Any]:
        self._kept = b""
        found = self._read()
        self._kept = to_json(found)
        return found


def _answer(query: zenoh.Query, act: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    try:
        answer = to_json(act(_asked(query)))
    except LimoError as error:
        query.reply_err(to_json({"error": str(error)}))
    except Exception as error:  # noqa: BLE001  # of our own; who asked should not wait in vain
        query.reply_err(to_json({"error": f"the service failed: {error!r}"}))
        _log.exception("a query on %s failed", query.key_expr)
    else:
        query.reply(query.key_expr, answer)


def _asked(query: zenoh.Query) -> dict[str, Any]:
    if query.payload is None:
        return {}
    data = query.payload.to_bytes()
    try:
        asked: object = json.loads(data) if len(data) <= _LONGEST else None
        json.dumps(asked, ensure_ascii=False).encode()  # half a character could not be told on
    except (ValueError, RecursionError):
        asked = None
    if not isinstance(asked, dict):
        raise LimoError('the query is no JSON object, expected for example {"version": "3"}')
    return asked


def _version(asked: dict[str, Any]) -> str:
    version = asked.get("version")
    if not isinstance(version, str | int) or not str(version):
        raise LimoError('the query names no version, expected for example {"version": "3"}')
    return str(version)


def _reason(asked: dict[str, Any]) -> str:
    return str(asked.get("reason") or "asked for")
