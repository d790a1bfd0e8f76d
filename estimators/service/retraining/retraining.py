"""The stages of retraining one arm: from drift to a better champion, or back.

    idle → gathering → training → vetting → shadow → promoted → probation → idle
                          └──────────┴─────────┴─ refused ─┘         └─ rollback ─┘

Drift, a command or the schedule starts training, in a process of its own, from the newest logs. The
challenger is vetted, judged beside the champion on live states, promoted if the gate says so, and
on probation until it has been no worse than the old champion for a while. Each step is an event.
Time is counted in joint states that came, so that an arm that rests unpowered misses nothing.

A service that is killed leaves its challenger by its alias and the rest in a file (`unfinished`);
the next one goes on: a challenger is judged anew, probation begins anew, and what was to be learned
is trained, a few times at most, in case it is the training that brings the service down.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from math import ceil
from traceback import format_exc
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.service.inference.contact import MARGIN
from estimators.service.retraining.drift import DriftWatch
from estimators.service.retraining.judge import (
    GATHERING,
    PROBATION,
    TRAINING,
    Judge,
    RetrainingFile,
    Stage,
    Unfinished,
)
from estimators.service.retraining.logged_motion import Span
from estimators.service.retraining.trainer import TrainingProcess
from limo_driver.errors import LimoError, MissingPackageError, ModelStoreError
from limo_driver.network.messages import Level

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from estimators.service.arm_server import ArmServer
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.live_model import Window
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.store import ModelStore
    from limo_driver.types import FloatArray

_PERIOD: Final = 1.0  # [s] between two looks
_HOUR: Final = 3600.0  # [s]
_TRIES: Final = 3  # trainings for one drift, which is told only once
_ASKED: Final = ("idle", GATHERING)  # stages in which a training can be asked for


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
        self.stage = Stage()
        self._judge = Judge(server, store, settings, self.stage)
        self._file = RetrainingFile(store.home, server.arm)
        self._asking = threading.Lock()
        self._asked: str | None = None  # why somebody wants a training
        self._trained = -np.inf  # [s], when the last training began
        self._process: TrainingProcess | None = None
        self._drift = self._watch()
        self._stages = self._live()  # one step each time it is asked for the next
        self._kept: ArmService | None = None  # whose states the stages are of
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Look once a second, on a thread of its own, until `close`."""
        self._thread = threading.Thread(target=self._look, name=f"limo-keep-{self._server.arm}")
        self._thread.start()

    def close(self) -> None:
        """Stop, and end a training that is under way; the next service goes on from here."""
        self._stopped.set()
        self._judge.stop()
        if self._thread is not None:
            self._thread.join()
        self._judge.close()
        self._end_training()

    def status(self) -> dict[str, Any]:
        """Return the stage of retraining and its facts, as JSON values."""
        return self.stage.as_values()

    def ask(self, reason: str) -> dict[str, Any]:
        """Train as soon as can be; what was being gathered for is trained at once.

        Raises:
            LimoError: A challenger is being trained or judged, or one was a short while ago, or
                what serves is not the champion.
        """
        with self._asking:
            if self.stage.name not in _ASKED or self._asked is not None:
                raise LimoError(f"cannot train now: the stage is {self.stage.name}")
            wait = self._wait
            if wait > 0:
                raise LimoError(
                    f"cannot train now: the last training was too short ago, by {wait:g} s"
                )
            self._check_champion()
            self._asked = reason
        return self.status()

    def watch(self, window: Window) -> None:
        """Take the service's summary of the last second or so."""
        if self._drift is not None:
            contact = bool(window.contacts) or bool(self._service.watchdog.active.any())
            self._drift.take(window, contact=contact)

    def tick(self) -> None:
        """Take the next step; report a failure of this program, and begin again with waiting."""
        try:
            if self._server.service is not self._kept:
                # Go on with states of another rate, like a service that has just started
                if self._kept is not None:
                    self._stages.close()
                    self._end_training()
                    self._trained = -np.inf
                    self.stage.enter("idle", 0.0)
                    self._stages = self._live()
                self._kept = self._server.service
            if self._kept is not None and not self._server.answering:
                return
            next(self._stages)
        except Exception as error:  # noqa: BLE001  # the stream has to go on
            self._server.outlet.event(
                "failure", f"retraining: {error!r}", Level.FATAL, trace=format_exc()
            )
            self._end_training()
            self._note(None)
            self._stages = self._keep(0.0 if self._server.service is None else self._now)

    def _look(self) -> None:
        while not self._stopped.wait(_PERIOD):
            self.tick()

    def _live(self) -> Generator[None]:
        """Go through the stages."""
        while self._server.service is None:
            yield
        began = self._now
        # Go on where the service before was stopped
        try:
            left = self._file.read()
        except ModelStoreError as error:
            self._server.outlet.event("refused", f"what was left is lost: {error}", Level.ERROR)
            self._note(left := None)
        aliases = self._store.aliases
        if left is not None and left.stage == PROBATION and aliases.champion == left.champion:
            yield from self._attempt(self._probation_anew(left))
        elif aliases.challenger is not None:
            reason = "left by the service before" if left is None else left.reason
            yield from self._attempt(self._judge_and_promote(str(aliases.challenger), reason))
        elif left is not None and left.stage == PROBATION:
            self._note(None)
            self._server.outlet.event(
                "probation_ended",
                f"probation of {left.champion} is over: {aliases.champion} is the champion",
                version=str(left.champion),
            )
        elif left is not None:
            yield from self._train_anew(left)
        yield from self._keep(began)

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

    def _probation_anew(self, left: Unfinished) -> Generator[None]:
        old, new = str(left.before), str(left.champion)
        self._server.outlet.event(
            "probation", f"probation of {new} begins anew with the service", version=new
        )
        n = len(self._service.arm.joint_names)
        predicted = [np.inf if v is None else float(v) for v in left.foretold or ()]
        ratios = np.array(predicted) if len(predicted) == n else np.full(n, np.inf)
        yield from self._probation(old, new, ratios)

    def _train_anew(self, left: Unfinished) -> Generator[None]:
        """Train what the service before was to train, if its training did not end it too often."""
        if left.tries < 1:
            self._note(None)
            self._server.outlet.event(
                "refused",
                f"training ended with the service and is not tried again: {left.reason}",
                Level.WARN,
                stage=TRAINING,
            )
            return
        yield from self._pursue(left, gather=left.stage == GATHERING)

    def _keep(self, began: float) -> Generator[None]:
        """Wait for a reason to train, and go through with it, again and again."""
        while True:
            self.stage.enter("idle", self._now)
            wanted = yield from self._reason(began)
            began = self._now
            yield from self._pursue(wanted, gather=wanted.stage == GATHERING)

    def _pursue(self, wanted: Unfinished, *, gather: bool) -> Generator[None]:
        """Train and judge; a training that fails is tried again while the reason is worth it."""
        self._note(wanted)
        while True:
            if gather:
                # Wait until what would be learned from is all of the arm as it is now
                until = self._now + max(self._settings.seconds, self._wait)
                self.stage.enter(GATHERING, self._now, reason=wanted.reason)
                while self._now < until and self._asked is None:
                    self.stage.note(left=until - self._now)
                    yield
            self._trained = self._now
            wanted = replace(wanted, stage=TRAINING, tries=wanted.tries - 1)
            judged = yield from self._attempt(self._retrain(wanted))
            if judged or wanted.tries < 1:
                return
            self._note(replace(wanted, stage=GATHERING))
            gather = True

    def _attempt(self, stages: Generator[None]) -> Generator[None, None, bool]:
        """Go through stages; where they fail, drop the challenger and say why.

        Returns:
            Whether it came to a challenger.
        """
        try:
            yield from stages
        except LimoError as error:
            self._refuse(str(error))
        finally:
            self._asked = None
            if self._drift is not None:
                self._drift.forget()
        self._note(None)
        return self.stage.name != TRAINING

    def _refuse(self, why: str) -> None:
        version = self.stage.challenger
        try:
            if version is not None and self._store.aliases.challenger == int(version):
                self._store.challenge(None, why)
        except ModelStoreError as error:
            why += f" (its alias stays: {error})"
        text = why if version is None else f"challenger {version} is dropped: {why}"
        self._server.outlet.event(
            "refused", text, Level.WARN, version=version, stage=self.stage.name
        )

    def _note(self, unfinished: Unfinished | None) -> None:
        """Keep what is not finished for the next service; the stream does not need it."""
        try:
            self._file.write(unfinished)
        except ModelStoreError as error:
            self._server.outlet.event(
                "failure", f"the stage of retraining is not kept: {error}", Level.WARN
            )

    def _reason(self, began: float) -> Generator[None, None, Unfinished]:
        """Wait for something that calls for training, and return what it is."""
        every = self._settings.every
        while True:
            # Report the joints that drift
            drifting = () if self._drift is None else self._drift.drifting(self._service)
            if drifting:
                named = ", ".join(map(str, drifting))
                self._server.outlet.event(
                    "drift",
                    f"the residual of joint {named} became larger",
                    Level.WARN,
                    joints=list(drifting),
                    version=self._service.model.version,
                )
            if self._asked is not None:
                return Unfinished(TRAINING, self._asked, tries=1)
            if drifting:
                reason = f"drift on joint {', '.join(map(str, drifting))}"
                return Unfinished(GATHERING, reason, tries=_TRIES)
            if every is not None and self._now - began >= every and self._wait <= 0:
                return Unfinished(TRAINING, f"{every / _HOUR:g} h since the last", tries=1)
            yield

    def _watch(self) -> DriftWatch | None:
        try:
            fewest = ceil(self._settings.reference)  # windows of about a second
            return DriftWatch(self._server.models.physics.model.n, fewest)
        except MissingPackageError as error:
            self._server.outlet.event("drift", f"drift is not detected: {error}", Level.WARN)
            return None

    def _retrain(self, wanted: Unfinished) -> Generator[None]:
        server, reason = self._server, wanted.reason
        self.stage.enter(TRAINING, self._now, reason=reason)
        self._check_champion()
        self._note(wanted)
        server.outlet.event("training", f"a challenger is trained: {reason}", reason=reason)
        found = yield from self._trained_aside()
        version = str(found["version"])
        self._store.challenge(version, reason)
        server.outlet.event("trained", f"challenger {version} is trained", reason=reason, **found)
        yield from self._judge_and_promote(version, reason)

    def _trained_aside(self) -> Generator[None, None, dict[str, Any]]:
        """Train in a process of its own, and return what it says."""
        service, settings = self._service, self._settings
        span = Span(settings.seconds, service.arm.rate, service.latest_stamp)
        margin = MARGIN + float(service.watchdog.duration.max())
        delay = self._server.settings.delay
        self._process = TrainingProcess(
            self._store, self._logs, self._server.arm, settings, span, delay, margin
        )
        while (found := self._process.result()) is None:
            yield
        return found

    def _end_training(self) -> None:
        if self._process is not None:
            self._process.end()

    def _check_champion(self) -> str:
        """Return the champion, which has to be what serves."""
        serves, champion = self._service.model.version, self._store.aliases.champion
        if champion is None or str(champion) != serves:
            raise LimoError(f"{serves} serves, but the champion is {champion}")
        return serves

    def _judge_and_promote(self, version: str, reason: str) -> Generator[None]:
        server = self._server
        self.stage.enter("vetting", self._now, challenger=version, reason=reason)
        champion = self._check_champion()
        server.models.vet(version, server.demand())
        yield
        self.stage.enter("shadow", self._now, challenger=version, reason=reason, champion=champion)
        server.outlet.event(
            "shadow", f"challenger {version} is judged beside {champion}", version=version
        )
        yield
        verdict = yield from self._judge.shadow(champion, version)
        predicted = verdict.ratio.high
        # Kept before it is so: a service that ends in between does not let it off probation.
        ratios = [float(v) if np.isfinite(v) else None for v in predicted]
        self._note(Unfinished(PROBATION, reason, 0, int(version), int(champion), ratios))
        server.promote(version, f"{reason}; {verdict.reason}", instead_of=champion)
        yield from self._probation(champion, version, predicted)

    def _probation(self, old: str, new: str, predicted: FloatArray) -> Generator[None]:
        self.stage.enter(PROBATION, self._now, champion=new, before=old)
        yield from self._judge.probation(old, new, predicted)
