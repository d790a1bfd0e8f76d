"""Keep the champion of one arm up to date: from drift to a better model, or back.

    idle → training → vetting → shadow → promoted → probation → idle
             └──────────┴─────────┴─ refused ─┘         └─ rollback ─┘

Drift, a command or the schedule starts training, in a process of its own, from the newest logs. The
challenger is vetted, judged beside the champion on live states, promoted if the gate says so, and
on probation until it has been no worse than the old champion for a while. Each step is an event.
Time is counted in joint states that came, so that an arm that rests unpowered misses nothing.
"""

from __future__ import annotations

import threading
from traceback import format_exc
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.service.background import thread_aside
from estimators.service.drift_watch import DriftWatch
from estimators.service.gate import FEWEST_BLOCKS
from estimators.service.shadow import Shadow
from estimators.service.training_process import TrainingProcess
from estimators.service.watchdog import MARGIN
from limo_driver.errors import BackendUnavailableError, LimoError
from limo_driver.messages import Level

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from estimators.service.arm_server import ArmServer
    from estimators.service.arm_service import ArmService, Window
    from estimators.service.gate import Comparison
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store import ModelStore

_PERIOD: Final = 1.0  # [s] between two looks
_HOUR: Final = 3600.0  # [s]


class Keeper:
    """Retrains the champion of an arm that is served; one thread, at most one training at a time.

    Args:
        server: Of the arm.
        store: Whose champion it serves.
        logs: Folder of the service's logs.
        settings: When, and how it is judged.
    """

    def __init__(
        self, server: ArmServer, store: ModelStore, logs: Path, settings: RetrainingSettings
    ) -> None:
        self._server, self._store, self._logs, self._settings = server, store, logs, settings
        self._facts: dict[str, Any] = {"stage": "idle"}
        self._asked: str | None = None  # why somebody wants a training
        self._trained = -np.inf  # [s], when the last training began
        self._process: TrainingProcess | None = None
        self._aside = thread_aside("limo-shadow")
        self._drift = self._watch()
        self._life = self._live()
        self._kept: ArmService | None = None  # whose states the stages are of
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Look once a second, on a thread of its own, until `close`."""
        self._thread = threading.Thread(target=self._look, name=f"limo-keep-{self._server.arm}")
        self._thread.start()

    def close(self) -> None:
        """Stop, and end a training that is under way."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
        self._aside.shutdown()
        if self._process is not None:
            self._process.end()

    def status(self) -> dict[str, Any]:
        """Return the stage and what is known of it, as JSON values."""
        return dict(self._facts)

    def ask(self, reason: str) -> dict[str, Any]:
        """Train as soon as can be.

        Raises:
            LimoError: A challenger is being trained or judged, or one was a short while ago.
        """
        if self._facts["stage"] != "idle" or self._asked is not None:
            raise LimoError(f"cannot train now: the stage is {self._facts['stage']}")
        wait = self._wait
        if wait > 0:
            raise LimoError(f"cannot train now: the last training was too short ago, by {wait:g} s")
        self._asked = reason
        return self.status()

    def watch(self, window: Window) -> None:
        """Take what the service summed up over the last second or so."""
        if self._drift is not None:
            contact = bool(window.contacts) or bool(self._service.watchdog.active.any())
            self._drift.take(window, contact=contact)

    def tick(self) -> None:
        """Take the next step; a failure of this program is told, and life begins anew."""
        if self._server.service is not self._kept:
            self._begin_anew()
        if self._kept is not None and not self._server.answering:
            return
        try:
            next(self._life)
        except Exception as error:  # noqa: BLE001  # the stream has to go on
            self._server.outlet.event(
                "failure", f"retraining: {error!r}", Level.FATAL, trace=format_exc()
            )
            self._enter("idle")
            self._life = self._keep(self._now)

    def _begin_anew(self) -> None:
        """Forget what was learned or judged on states of another rate."""
        if self._kept is not None:
            self._life.close()
            if self._process is not None:
                self._process.end()
            self._trained = -np.inf
            self._facts = {"stage": "idle"}
            self._life = self._live()
        self._kept = self._server.service

    @property
    def _service(self) -> ArmService:
        assert self._server.service is not None  # noqa: S101  # `_live` waits for it
        return self._server.service

    @property
    def _now(self) -> float:
        """Seconds of states that came."""
        return self._service.history.count / self._service.arm.rate

    @property
    def _wait(self) -> float:
        """Seconds until the next training may begin."""
        return self._trained + self._settings.pause - self._now

    def _look(self) -> None:
        while not self._stopped.wait(_PERIOD):
            self.tick()

    def _live(self) -> Generator[None]:
        """Go through the stages, one step each time it is asked for the next."""
        while self._server.service is None:
            yield
        began = self._now
        left = self._store.aliases.challenger
        if left is not None:
            yield from self._attempt(self._judge(str(left), "left by the service before"))
        yield from self._keep(began)

    def _keep(self, began: float) -> Generator[None]:
        """Wait for a reason to train, and go through with it, again and again."""
        while True:
            self._enter("idle")
            reason = yield from self._reason(began)
            began = self._trained = self._now
            yield from self._attempt(self._retrain(reason))

    def _attempt(self, stages: Generator[None]) -> Generator[None]:
        """Go through stages; where they fail, drop the challenger and say why."""
        try:
            yield from stages
        except LimoError as error:
            self._refuse(str(error))
        finally:
            self._asked = None
            if self._drift is not None:
                self._drift.forget()

    def _refuse(self, why: str) -> None:
        version = self._facts.get("challenger")
        if version is not None and self._store.aliases.challenger == int(version):
            self._store.challenge(None, why)
        text = why if version is None else f"challenger {version} is dropped: {why}"
        self._server.outlet.event(
            "refused", text, Level.WARN, version=version, stage=self._facts["stage"]
        )

    def _enter(self, stage: str, **facts: object) -> None:
        self._facts = {"stage": stage, "since": self._now, **facts}

    def _reason(self, began: float) -> Generator[None, None, str]:
        """Wait for something that calls for training, and return what it is."""
        every = self._settings.every
        while True:
            drifting = self._drifting()
            if self._asked is not None:
                return self._asked
            if drifting:
                reason = f"drift on joint {', '.join(map(str, drifting))}"
                yield from self._gather(reason)
                return reason
            if every is not None and self._now - began >= every and self._wait <= 0:
                return f"{every / _HOUR:g} h since the last"
            yield

    def _gather(self, reason: str) -> Generator[None]:
        """Wait until what would be learned from is all of the arm as it is now."""
        until = self._now + max(self._settings.seconds, self._wait)
        self._enter("gathering", reason=reason)
        while self._now < until:
            self._facts["left"] = until - self._now
            yield

    def _drifting(self) -> tuple[int, ...]:
        """Return the joints that drift now, and tell it."""
        joints = () if self._drift is None else self._drift.drifting(self._service)
        if joints:
            named = ", ".join(map(str, joints))
            self._server.outlet.event(
                "drift",
                f"the residual of joint {named} became larger",
                Level.WARN,
                joints=list(joints),
                version=self._service.model.version,
            )
        return joints

    def _watch(self) -> DriftWatch | None:
        try:
            return DriftWatch(self._server.models.physics.model.n)
        except BackendUnavailableError as error:
            self._server.outlet.event("drift", f"drift is not detected: {error}", Level.WARN)
            return None

    def _retrain(self, reason: str) -> Generator[None]:
        server, settings = self._server, self._settings
        self._enter("training", reason=reason)
        self._check_champion()
        server.outlet.event("training", f"a challenger is trained: {reason}", reason=reason)
        margin = MARGIN + float(self._service.watchdog.duration.max())
        self._process = TrainingProcess(
            self._store, self._logs, server.arm, settings, server.settings.delay, margin
        )
        while (found := self._process.result()) is None:
            yield
        version = str(found["version"])
        self._store.challenge(version, reason)
        server.outlet.event("trained", f"challenger {version} is trained", reason=reason, **found)
        yield from self._judge(version, reason)

    def _check_champion(self) -> str:
        """Return the champion, which has to be what serves."""
        serves, champion = self._service.model.version, self._store.aliases.champion
        if champion is None or str(champion) != serves:
            raise LimoError(f"{serves} serves, but the champion is {champion}")
        return serves

    def _judge(self, version: str, reason: str) -> Generator[None]:
        server = self._server
        self._enter("vetting", challenger=version, reason=reason)
        champion = self._check_champion()
        server.models.vet(version, server.demand())
        yield
        self._enter("shadow", challenger=version, reason=reason, champion=champion)
        server.outlet.event(
            "shadow", f"challenger {version} is judged beside {champion}", version=version
        )
        yield
        verdict = yield from self._shadow(champion, version)
        facts = server.promote(version, f"{reason}; {verdict.reason}")
        yield from self._probation(champion, str(facts["version"]), verdict)

    def _shadow(self, champion: str, challenger: str) -> Generator[None, None, Comparison]:
        """Judge until the challenger is found better.

        Raises:
            LimoError: It is worse, or not better for too long.
        """
        shadow = self._compared(champion, challenger)
        began = self._now
        due = self._settings.shadow
        while True:
            yield
            if self._service.model.version != champion:
                raise LimoError(f"{self._service.model.version} serves by now, not {champion}")
            self._aside.submit(shadow.take).result()
            self._facts["judged"] = shadow.seconds
            ended = self._now - began >= self._settings.shadow_limit
            if shadow.seconds < due and not ended:
                continue
            verdict = shadow.comparison()
            due *= 2.0  # few looks, so that none is lucky
            if verdict is not None:
                self._facts["verdict"] = verdict.reason
                if verdict.promote:
                    self._tell_verdict(challenger, verdict)
                    return verdict
                if verdict.enough and (verdict.worse or verdict.mean_ratio.low > 1.0):
                    raise LimoError(verdict.reason)
            if ended:
                told = "nothing could be judged" if verdict is None else verdict.reason
                raise LimoError(f"undecided after {self._settings.shadow_limit:g} s: {told}")

    def _tell_verdict(self, challenger: str, verdict: Comparison) -> None:
        self._server.outlet.event(
            "shadow",
            f"challenger {challenger} is {verdict.reason}",
            version=challenger,
            verdict=verdict.as_values(),
        )

    def _probation(self, old: str, new: str, foretold: Comparison) -> Generator[None]:
        """Send the new champion back if it is worse than the old one, or fails."""
        self._enter("probation", champion=new, before=old)
        shadow = self._compared(old, new)
        due = min(self._settings.shadow, self._settings.probation)
        while True:
            yield
            serving = self._service.model
            if serving.physics_only:
                self._server.rollback(f"version {new} failed on probation")
                return
            if serving.version != new:
                raise LimoError(f"{serving.version} serves by now: probation of {new} is over")
            self._aside.submit(shadow.take).result()
            self._facts["judged"] = shadow.seconds
            if shadow.seconds < due:
                continue
            found = shadow.comparison()
            if found is not None and (why := _broken(found, foretold)):
                self._server.rollback(f"version {new} on probation: {why}")
                return
            if shadow.seconds >= self._settings.probation:
                break
            due = min(2.0 * due, self._settings.probation)
        self._server.outlet.event(
            "probation_passed",
            f"{new} stays the champion",
            version=new,
            foretold=foretold.mean_ratio.value.tolist(),
            found=None if found is None else found.as_values(),
        )

    def _compared(self, champion: str, challenger: str) -> Shadow:
        """Return both beside each other, loaded aside from the stream."""
        versions = (champion, challenger)
        models = [self._aside.submit(self._server.loaded, v).result() for v in versions]
        return Shadow(self._service, *models)


def _broken(found: Comparison, foretold: Comparison) -> str:
    """Return in which way a new champion is worse than the old one; nothing if it is not.

    A joint counts if it is worse beyond its interval, and beyond what the shadow foretold.
    """
    if found.blocks < FEWEST_BLOCKS:
        return ""
    if found.mean_ratio.low > 1.0:
        return f"worse than before: {found.reason}"
    worse = found.ratio.low > np.maximum(1.0, foretold.ratio.high)
    joints = ", ".join(str(int(j) + 1) for j in np.flatnonzero(worse))
    return f"worse on joint {joints} than before and than foretold" if joints else ""
