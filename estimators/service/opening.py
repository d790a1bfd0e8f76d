"""How the service of an arm opens, and what it answers to those who may ask."""

from __future__ import annotations

import json
import logging
import math
import time
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from estimators.embedded.compiled_stream import fastest
from estimators.residual_model import SimulationOnly
from estimators.service.inference.arm_service import ArmService, ServedArm
from estimators.service.inference.contact import ContactReport, ContactWatchdog
from estimators.service.inference.live_model import Answer, LiveModel, RateFinder, Window
from estimators.service.store.served_models import READY
from estimators.stream import Stream
from limo_driver.errors import LimoError
from limo_driver.model.units import unit_of
from limo_driver.network.claims import PacedQueryable
from limo_driver.network.messages import Level
from limo_driver.network.streaming import to_json
from limo_driver.recordings.bandwidth import BANDWIDTH, bandwidth_at
from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE
from limo_driver.types import readonly

if TYPE_CHECKING:
    from collections.abc import Callable

    import zenoh

    from estimators.service.inference.inbox import NetworkOutlet
    from estimators.service.model_changes import ModelChanges
    from estimators.service.settings import ServiceSettings
    from estimators.service.store.served_models import ServedModels

PHYSICS: Final = "physics"  # version of estimates without a learned part
_USUAL_RATE: Final = 1000.0  # [Hz]
_log = logging.getLogger("limo")
_LONGEST: Final = 4096  # bytes of a query
_ASKED, _AT_ONCE = 50.0, 50  # queries of a verb that are answered: in a second, and together
_READ, _READ_AT_ONCE = 25_000.0, 4096  # of one whose answer is kept: 20 us each, half a core
_KEPT: Final = 0.05  # [s] for which that answer stands


class Opening:
    """Opens the service of one arm, as often as its states come at another rate.

    Args:
        arm: Its name in keys.
        models: What can serve.
        settings: How.
        outlet: Of the arm; told which models are refused.
    """

    def __init__(
        self, arm: str, models: ServedModels, settings: ServiceSettings, outlet: NetworkOutlet
    ) -> None:
        self._arm, self._models, self._settings, self._outlet = arm, models, settings, outlet
        self._finder = RateFinder()
        self._streams: deque[Stream] = deque(maxlen=READY)  # the latest, should one come back

    def rate(self, sequence: int, stamp: int, *, first: bool) -> float | None:
        """Take a state, and return the rate to serve [Hz] once it is known.

        A stated one is believed until states came at another.

        Args:
            sequence: Number of the state.
            stamp: When it was measured [ns].
            first: Whether nothing was served yet.
        """
        stated = self._settings.rate
        if stated is not None and first:
            return stated
        found = self._finder.take(sequence, stamp)
        if stated is None or found is None:
            return found
        return stated if abs(found / stated - 1.0) <= RATE_TOLERANCE else None

    def service(self, rate: float) -> ArmService:
        """Return the service at a rate [Hz], with the champion or what stands in for it.

        Raises:
            LimoError: Not even the physics can be served at that rate.
        """
        simulation, settings = self._models.physics, self._settings
        bound = settings.bounds(simulation.model.limits)
        model = simulation.model
        units = tuple(unit_of("N m", model.sliding, j) for j in range(model.n))
        arm = ServedArm(self._arm, model.joint_names, rate, settings.history, bound, units)
        physics = SimulationOnly(simulation, bandwidth_at(rate, simulation.bandwidth or BANDWIDTH))
        stream = fastest(Stream(physics, rate, settings.delay))
        warm_up(stream)
        service = ArmService(
            arm,
            LiveModel(PHYSICS, stream, bound, physics_only=True),
            ContactWatchdog(*settings.contact(simulation.model.n)),
            self._outlet,
        )
        service.model = self._first_model(service)
        return service

    def loaded(self, version: str, arm: ServedArm) -> LiveModel:
        """Load a version for an arm, with everything compiled that its first answer needs.

        Raises:
            LimoError: It cannot be read, or not be streamed at the arm's rate.
        """
        model = self._models.load(version)
        known = tuple(self._streams)  # others may load meanwhile
        stream = next((s for s in known if s.model is model and s.rate == arm.rate), None)
        if stream is None:
            stream = fastest(Stream(model, arm.rate, self._settings.delay))
            warm_up(stream)
            self._streams.append(stream)
        return LiveModel(version, stream, arm.bound)

    def _first_model(self, service: ArmService) -> LiveModel:
        """Return the champion, or else a champion before it, or else the physics."""
        try:
            candidates = self._models.candidates
        except LimoError as error:
            self._outlet.event("refused", f"no champion is known: {error}", Level.ERROR)
            return service.model
        for candidate in candidates:
            try:
                return self.loaded(candidate, service.arm)
            except LimoError as error:
                self._outlet.event("refused", f"champion {candidate}: {error}", Level.ERROR)
        return service.model


def rehearse(models: ServedModels, settings: ServiceSettings) -> None:
    """Load what will likely serve, so that all is imported and compiled when joint states come."""
    with suppress(LimoError):  # which is told when it is to serve
        for model in (models.physics, *map(models.load, models.candidates[:1])):
            warm_up(fastest(Stream(model, settings.rate or _USUAL_RATE, settings.delay)))


def warm_up(stream: Stream) -> None:
    """Answer a few states at rest, so that the first real one finds everything compiled.

    With torque and without, of arrays that are read-only, as those off the wire are.
    """
    n, rate = stream.model.n, stream.rate
    still = readonly(np.zeros(n))
    watchdog, window, answer = ContactWatchdog(np.ones(n), np.ones(n)), Window(n), Answer.of(n)
    report = ContactReport(watchdog)
    for torque in (still, None):
        model = LiveModel("", stream, np.ones(n))
        for k in range(3):
            model.step(k / rate, still, torque, answer)
            watchdog.step(k / rate, answer.external)
            report.step(k / rate, answer.external, answer.std, known=True)
            window.add(answer, watchdog.active, watchdog.active, known=True)
        rows = None if torque is None else torque[None]
        stream.advance(model.state, np.array([3 / rate]), still[None], rows)


class ModelQueries:
    """Answers queries on `limo/<arm>/model/<verb>`, those of each verb one after the other.

    A query's payload is a JSON object, `{"version": "3", "reason": "..."}` where that is needed;
    the answer is one, too, or an error that says why not. Of a flood of queries that change models,
    most are not answered, so that it does not hold the stream; of those that ask for the index,
    whose answer is made twenty times a second at most whatever they say, nearly all are.

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
        key, index = server.keys.model, _Kept(server.index)
        self._queryables = [
            PacedQueryable(session, key("index"), index.answer, _READ, _READ_AT_ONCE),
            *(
                PacedQueryable(
                    session, key(verb), lambda q, act=act: _answer(q, act), _ASKED, _AT_ONCE
                )
                for verb, act in verbs.items()
            ),
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
        self._read, self._clock, self._ends = read, clock, -math.inf
        self._kept = _Outcome(b"", fine=False)

    def answer(self, query: zenoh.Query) -> None:
        """Answer a query, whatever it says: what it says is not read, and cannot cost anything."""
        if self._clock() >= self._ends:
            self._kept = _outcome(self._read, query)
            self._ends = self._clock() + _KEPT
        _reply(query, self._kept)


class _Outcome(NamedTuple):
    """An answer as it is sent."""

    said: bytes
    fine: bool  # else it says why not


def _answer(query: zenoh.Query, act: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    _reply(query, _outcome(lambda: act(_asked(query)), query))


def _outcome(act: Callable[[], dict[str, Any]], query: zenoh.Query) -> _Outcome:
    try:
        return _Outcome(to_json(act()), fine=True)
    except LimoError as error:
        return _Outcome(to_json({"error": str(error)}), fine=False)
    except Exception as error:  # noqa: BLE001  # of our own; who asked should not wait in vain
        _log.exception("a query on %s failed", query.key_expr)
        return _Outcome(to_json({"error": f"the service failed: {error!r}"}), fine=False)


def _reply(query: zenoh.Query, outcome: _Outcome) -> None:
    if outcome.fine:
        query.reply(query.key_expr, outcome.said)
    else:
        query.reply_err(outcome.said)


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


class Retrainer(Protocol):
    """Interface of the keeper of a server's champion, see `Keeper`."""

    def watch(self, window: Window) -> None:
        """Take the service's summary of the last second or so."""
        ...

    def status(self) -> dict[str, Any]:
        """Return the stage of retraining and its facts, as JSON values."""
        ...

    def ask(self, reason: str) -> dict[str, Any]:
        """Train as soon as can be, and return the status."""
        ...

    def close(self) -> None:
        """Stop, and end a training that is under way."""
        ...
