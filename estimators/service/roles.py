"""Roles: interfaces between the parts of a served arm, so that they do not import each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from estimators.service.inference.window import Window
    from limo_driver.network.streaming import Keys


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


class ModelChanges(Protocol):
    """Interface of a running service for questions about its models, see `ArmServer`."""

    keys: Keys

    def index(self) -> dict[str, Any]:
        """Return which models there are and which serves, as JSON values."""
        ...

    def load(self, version: str) -> dict[str, Any]:
        """Let a version serve."""
        ...

    def promote(self, version: str, reason: str) -> dict[str, Any]:
        """Let a version serve, and make it the champion."""
        ...

    def rollback(self, reason: str) -> dict[str, Any]:
        """Let the champion before serve again."""
        ...

    def retrain(self, reason: str) -> dict[str, Any]:
        """Train a challenger as soon as can be."""
        ...
