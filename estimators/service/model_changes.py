"""Changes of the model that serves an arm, one after the other; a rollback goes first."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from limo_driver.errors import LimoError, ModelStoreError
from limo_driver.network.messages import Level

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from estimators.service.inference.arm_service import ArmService
    from estimators.service.inference.inbox import NetworkOutlet
    from estimators.service.inference.live_model import LiveModel
    from estimators.service.store.served_models import ServedModels
    from estimators.service.store.vetting import Demand
    from limo_driver.network.streaming import Keys


class ModelChanges(ABC):
    """Loads, promotes and rolls back; a subclass has the service and its states.

    Args:
        models: What can serve.
        outlet: Of the arm; events of each change go there.
    """

    keys: Keys

    def __init__(self, models: ServedModels, outlet: NetworkOutlet) -> None:
        self.models, self.outlet = models, outlet
        self.changing = threading.Lock()  # held while another model begins to serve
        self._admitting = threading.Lock()  # one new model is vetted after the other
        self._rollbacks = 0

    @abstractmethod
    def running(self) -> ArmService:
        """Return the service.

        Raises:
            LimoError: It answers no states now.
        """

    @abstractmethod
    def demand(self) -> Demand:
        """Return the requirements on a version."""

    @abstractmethod
    def loaded(self, version: str) -> LiveModel:
        """Load a version, with everything compiled that its first answer needs."""

    @abstractmethod
    def index(self) -> dict[str, Any]:
        """Return which models there are, as JSON values."""

    @abstractmethod
    def retrain(self, reason: str) -> dict[str, Any]:
        """Train a challenger as soon as can be."""

    def load(self, version: str) -> dict[str, Any]:
        """Let a version serve that was found fit to, until the service ends.

        Raises:
            LimoError: It is not fit, or cannot follow the stream; the old one serves on.
        """
        return self._admit(version, lambda _: None)

    def promote(self, version: str, reason: str, instead_of: str | None = None) -> dict[str, Any]:
        """Let a version serve, and make it the champion.

        Args:
            version: Its number or alias.
            reason: Why, for the record.
            instead_of: Champion that it was judged against; no other is replaced.

        Raises:
            LimoError: As for `load`, or it is the champion, or another one is than was judged
                against; nothing changes.
        """
        version = self.models.number(version)
        if version in self.models.candidates[:1]:
            raise ModelStoreError(f"version {version} is the champion already; load it to serve")
        facts = self._admit(version, lambda number: self.models.promote(number, reason, instead_of))
        self.outlet.event("promoted", f"{version} is the champion: {reason}", **facts)
        return facts

    def rollback(self, reason: str, instead_of: str | None = None) -> dict[str, Any]:
        """Let the champion before serve again, at once: whatever is being vetted is not waited for.

        Args:
            reason: Why, for the record.
            instead_of: Champion that is sent back; no other is.

        Raises:
            LimoError: There is none, or it cannot be read, or another one is the champion; nothing
                changes.
        """
        service, began = self.running(), time.monotonic()
        with self.changing, self._refusals("champion"):
            _, *before = self.models.candidates or ("",)
            if not before:
                raise ModelStoreError("there is no champion before this one to roll back to")
            model = self.loaded(before[0])
            facts = self._change(
                service, model, began, lambda _: self.models.rollback(reason, instead_of)
            )
            self._rollbacks += 1
        self.outlet.event(
            "rollback", f"{before[0]} is the champion again: {reason}", Level.WARN, **facts
        )
        return facts

    def finish_changes(self) -> None:
        """Wait until a change that is under way has come to its end."""
        with self._admitting, self.changing:
            pass

    def _admit(self, which: str, note: Callable[[str], None]) -> dict[str, Any]:
        """Let a version serve if it is fit to; a rollback meanwhile goes before it."""
        service, began = self.running(), time.monotonic()
        with self._admitting, self._refusals(which):
            version, rollbacks = self.models.number(which), self._rollbacks
            self.models.vet(version, self.demand())
            decided = time.monotonic()
            model = self.loaded(version)
            with self.changing:
                if self._rollbacks != rollbacks:
                    raise ModelStoreError(f"version {version}: there was a rollback meanwhile")
                return self._change(service, model, began, note, vetting=decided - began)

    @contextmanager
    def _refusals(self, version: str) -> Generator[None]:
        """Tell why a model is not let serve."""
        try:
            yield
        except LimoError as error:
            self.outlet.event("refused", str(error), Level.ERROR, version=version)
            raise

    def _change(
        self,
        service: ArmService,
        model: LiveModel,
        began: float,
        note: Callable[[str], None],
        vetting: float = 0.0,
    ) -> dict[str, Any]:
        """Swap a model in, and note it; where that fails, nothing changes.

        Args:
            service: Of the arm.
            model: With everything compiled.
            began: When it was asked for [s].
            note: Called with its version afterwards.
            vetting: Of the time since then [s].
        """
        before = service.swap(model)
        try:
            note(model.version)
        except LimoError:
            service.swap(before)
            raise
        facts: dict[str, Any] = {
            "version": model.version,
            "before": before.version,
            "seconds": time.monotonic() - began,
            "vetting": vetting,
        }
        self.outlet.event("swap", f"{model.version} serves instead of {before.version}", **facts)
        return facts
