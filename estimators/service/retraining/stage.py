"""The stage that retraining is in, written by one thread and read by others."""

from __future__ import annotations

from typing import Any


class Stage:
    """A name, since when it is so, and what is known of it; each change is one new dict."""

    def __init__(self) -> None:
        self._facts: dict[str, Any] = {"stage": "idle"}

    @property
    def name(self) -> str:
        """What it is called, for example `idle`."""
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
