"""Follow one source of joint states, and notice when none come."""

from __future__ import annotations

import time
from typing import Final

_SILENT: Final = 1.0  # [s] after which another source is followed
_DEAD: Final = 5.0  # [s] without states, after which it is told


class FollowedSource:
    """One source of joint states at a time, until it is silent."""

    def __init__(self) -> None:
        self._source, self._heard = "", -float("inf")  # and when it last sent [s]
        self._other: str | None = None  # that is not followed
        self._told = False

    def is_foreign(self, source: str) -> bool:
        """Say whether a state is of another source than the one that is followed."""
        if source == self._source or time.monotonic() - self._heard > _SILENT:
            return False
        self._other = source
        return True

    def follow(self, source: str) -> str | None:
        """Keep to the source of a state.

        Returns:
            What to tell, once, if another one sends at the same time.
        """
        if source != self._source:
            self._source, self._other, self._told = source, None, False
        self._heard = time.monotonic()
        if self._other is None or self._told:
            return None
        self._told = True
        return (
            f"two sources send joint states; {source or 'one'} is answered, "
            f"{self._other or 'the other'} is not"
        )


class StateSilence:
    """Time since joint states came."""

    def __init__(self) -> None:
        self._arrived, self._arrived_at = -1, 0.0  # states, and when the last ones were seen [s]
        self.silent = False  # for so long that it is told

    def look(self, arrived: int, *, answering: bool) -> bool:
        """Look how many states arrived in all, and say whether silence began or ended."""
        now = time.monotonic()
        if arrived != self._arrived or not answering:
            self._arrived, self._arrived_at = arrived, now
        before, self.silent = self.silent, now - self._arrived_at > _DEAD
        return self.silent != before

    @property
    def lasts(self) -> float:
        """Time since states were last seen [s]."""
        return time.monotonic() - self._arrived_at

    @property
    def limit(self) -> float:
        """Time without states after which silence is reported [s]."""
        return _DEAD
