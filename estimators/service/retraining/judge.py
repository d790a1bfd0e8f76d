"""A challenger and the champion side by side: before it may serve, and while it is on probation.

Keep the unfinished stage of retraining on disk, so that the next service can resume it.

models/<robot>/retraining-<arm>.json

A challenger that is judged is kept by its alias; what else has to survive is that the arm changed
and nothing was learned from it yet, and that a champion is on probation.

Also the current stage of retraining, written by one thread and read by others.
"""

from __future__ import annotations

import json
import threading
from dataclasses import asdict, dataclass
from math import floor, log2
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from estimators.service.comparison import Shadow
from estimators.service.gate import FEWEST_BLOCKS
from estimators.service.store.aliases import locked
from estimators.service.store.aliases import replace_file as replace
from limo_driver.errors import LimoError, ModelStoreError
from limo_driver.runtime.declarations import read_json
from limo_driver.runtime.processes import thread_aside

if TYPE_CHECKING:
    from collections.abc import Generator
    from pathlib import Path

    from estimators.service.arm_server import ArmServer
    from estimators.service.gate import Comparison
    from estimators.service.inference.arm_service import ArmService
    from estimators.service.settings import RetrainingSettings
    from estimators.service.store.store import ModelStore
    from limo_driver.types import FloatArray

_PAUSE: Final = 60.0  # seconds of joint states before a rollback that failed is tried again
_ROLLBACKS: Final = 5  # tries
GATHERING, TRAINING, PROBATION = "gathering", "training", "probation"
_SCHEMA: Final = 1
_STAGES: Final = (GATHERING, TRAINING, PROBATION)
_FIELDS: Final[dict[str, tuple[type, ...]]] = {
    "stage": (str,),
    "reason": (str,),
    "tries": (int,),
    "champion": (int, type(None)),
    "before": (int, type(None)),
    "foretold": (list, type(None)),
}


class Judge:
    """Compares models on the live states of a server, on a thread that gives way.

    Its verdicts are generators, which take one step each time they are asked for the next.

    Args:
        server: Of the arm.
        store: Whose champion it serves.
        settings: How long.
        stage: Told what is known so far.
    """

    def __init__(
        self, server: ArmServer, store: ModelStore, settings: RetrainingSettings, stage: Stage
    ) -> None:
        self._server, self._store = server, store
        self._settings, self._stage = settings, stage
        self._aside = thread_aside("limo-shadow")
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Leave what is being compared; nothing is judged any more."""
        self._stopped.set()

    def close(self) -> None:
        """End the thread."""
        self._aside.shutdown()

    def shadow(self, champion: str, challenger: str) -> Generator[None, None, Comparison]:
        """Judge until the challenger is found better.

        Raises:
            LimoError: It is worse, or not better for too long, or another version serves by now.
        """
        shadow = self._compared(champion, challenger)
        began = self._now
        due, limit = self._settings.shadow, self._settings.shadow_limit
        looks = 2 + max(0, floor(log2(limit / due)))  # at the end, too; few, so that none is lucky
        while True:
            yield
            self._check_serving(champion, challenger)
            self._aside.submit(shadow.take, self._stopped).result()
            self._stage.note(judged=shadow.seconds)
            ended = self._now - began >= limit
            if shadow.seconds < due and not ended:
                continue
            verdict = shadow.comparison(looks)
            due *= 2.0
            if verdict is not None:
                self._stage.note(verdict=verdict.reason)
                if verdict.promote:
                    self._server.outlet.event(
                        "shadow",
                        f"challenger {challenger} is {verdict.reason}",
                        version=challenger,
                        verdict=verdict.as_values(),
                    )
                    return verdict
                if verdict.drop:
                    raise LimoError(verdict.reason)
            if ended:
                told = "nothing could be judged" if verdict is None else verdict.reason
                raise LimoError(f"undecided after {limit:g} s: {told}")

    def probation(self, old: str, new: str, predicted: FloatArray) -> Generator[None]:
        """Send the new champion back if it is worse than the old one, or fails.

        Args:
            old: The champion before.
            new: The champion.
            predicted: Squared errors of the new one beside those of the old one, at most, (n,).

        Raises:
            LimoError: Somebody else changed what serves, or it could not be sent back.
        """
        if self._service.model.version == old:  # what should serve could not be loaded
            yield from self._send_back(old, new, f"version {new} could not be served")
            return
        if self._service.model.physics_only:
            yield from self._send_back(old, new, f"version {new} failed on probation")
            return
        shadow = self._compared(old, new)
        due = min(self._settings.shadow, self._settings.probation)
        while True:
            yield
            serving = self._service.model
            if serving.physics_only:
                yield from self._send_back(old, new, f"version {new} failed on probation")
                return
            # Somebody may have changed the store or what serves
            aliases = self._store.aliases
            if serving.version != new:
                raise LimoError(f"{serving.version} serves by now: probation of {new} is over")
            if str(aliases.champion) != new:
                raise LimoError(
                    f"{aliases.champion} is the champion by now: probation of {new} is over"
                )
            if not aliases.previous or str(aliases.previous[-1]) != old:
                raise LimoError(f"{old} is no longer what {new} came after: its probation is over")
            self._aside.submit(shadow.take, self._stopped).result()
            self._stage.note(judged=shadow.seconds)
            if shadow.seconds < due:
                continue
            found = shadow.comparison()
            if found is not None and (why := broken(found, predicted)):
                yield from self._send_back(old, new, f"version {new} on probation: {why}")
                return
            if shadow.seconds >= self._settings.probation:
                break
            due = min(2.0 * due, self._settings.probation)
        self._server.outlet.event(
            "probation_passed",
            f"{new} stays the champion",
            version=new,
            found=None if found is None else found.as_values(),
        )

    @property
    def _service(self) -> ArmService:
        assert self._server.service is not None  # noqa: S101  # nothing is judged before
        return self._server.service

    @property
    def _now(self) -> float:
        """Seconds of states that came."""
        return self._service.history.count / self._service.arm.rate

    def _check_serving(self, champion: str, challenger: str) -> None:
        serves = self._service.model.version
        if serves == challenger:
            raise LimoError(f"{challenger} was let serve meanwhile, so that it is judged no more")
        if serves != champion:
            raise LimoError(f"{serves} serves by now, not {champion}")

    def _send_back(self, old: str, new: str, why: str) -> Generator[None]:
        """Roll back; where that fails, on a machine that is busy for example, try again later."""
        for left in reversed(range(_ROLLBACKS)):
            try:
                self._server.rollback(why, instead_of=new)
            except LimoError:  # which is told
                if not left or str(self._store.aliases.champion) != new:
                    raise
            else:
                return
            until = self._now + _PAUSE
            self._stage.note(verdict=f"{why}; going back to {old} is tried again")
            while self._now < until:
                yield

    def _compared(self, champion: str, challenger: str) -> Shadow:
        """Return both beside each other, loaded aside from the stream."""
        versions = (champion, challenger)
        models: list[Any] = [self._aside.submit(self._server.loaded, v).result() for v in versions]
        return Shadow(self._service, *models)


def broken(found: Comparison, predicted: FloatArray) -> str:
    """Return in which way a new champion is worse than the old one; nothing if it is not.

    A joint counts if it is worse beyond its interval, and beyond what the shadow predicted.
    """
    if found.blocks < FEWEST_BLOCKS:
        return ""
    if found.mean_ratio.low > 1.0:
        return f"worse than before: {found.reason}"
    worse = found.ratio.low > np.maximum(1.0, predicted)
    joints = ", ".join(str(int(j) + 1) for j in np.flatnonzero(worse))
    return f"worse on joint {joints} than before and than predicted" if joints else ""


@dataclass(frozen=True)
class Unfinished:
    """A stage that has not come to its end."""

    stage: str
    reason: str  # why a challenger is, or was, trained
    tries: int  # trainings that may still begin for this reason
    champion: int | None = None  # on probation
    before: int | None = None  # that it goes back to
    # Its squared errors beside those before, at most, as the shadow predicted; None: not known.
    foretold: list[float | None] | None = None


class RetrainingFile:
    """The file of one arm.

    Args:
        home: Folder of the robot's versions.
        arm: Name of the arm in keys.
    """

    def __init__(self, home: Path, arm: str) -> None:
        self._home, self._path = home, home / f"retraining-{arm}.json"

    def read(self) -> Unfinished | None:
        """Return what was not finished; None if nothing was.

        Raises:
            ModelStoreError: The file cannot be read or understood.
        """
        if not self._path.exists():
            return None
        given = read_json(self._path, ModelStoreError, _SCHEMA)
        content = given.content
        for name, kinds in _FIELDS.items():
            if not isinstance(content.get(name, ...), kinds):
                given.fail(f"{name} is missing or of the wrong type")
        given.text("stage", _STAGES)
        ratios = content["foretold"] or []
        if not all(ratio is None or isinstance(ratio, int | float) for ratio in ratios):
            given["foretold"].refuse("a list of numbers")
        return Unfinished(**{name: content[name] for name in _FIELDS})

    def write(self, unfinished: Unfinished | None) -> None:
        """Keep a stage instead of the one before; None: everything is finished.

        Raises:
            ModelStoreError: It cannot be written.
        """
        if unfinished is None and not self._path.exists():
            return
        try:
            with locked(self._home):
                if unfinished is None:
                    self._path.unlink(missing_ok=True)
                else:
                    content = {"schema": _SCHEMA, **asdict(unfinished)}
                    replace(self._path, (json.dumps(content, indent=1) + "\n").encode())
        except OSError as error:
            raise ModelStoreError(f"{self._path}: cannot be written: {error.strerror}") from None


class Stage:
    """A name, since when it is so, and what is known of it; each change is one new dict."""

    def __init__(self) -> None:
        self._facts: dict[str, Any] = {"stage": "idle"}

    @property
    def name(self) -> str:
        """Its name, for example `idle`."""
        return self._facts["stage"]

    @property
    def challenger(self) -> str | None:
        """Version that it is about, if there is one yet."""
        return self._facts.get("challenger")

    def enter(self, name: str, since: float, **facts: object) -> None:
        """Go over to a stage, `since` in seconds of joint states."""
        self._facts = {"stage": name, "since": since, **facts}

    def note(self, **facts: object) -> None:
        """Add what is known by now."""
        self._facts = {**self._facts, **facts}

    def as_values(self) -> dict[str, Any]:
        """Return all of it as JSON values."""
        return dict(self._facts)
