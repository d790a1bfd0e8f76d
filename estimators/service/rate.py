"""The rate of numbered joint states, some of which may be lost."""

from __future__ import annotations

from typing import Final

import numpy as np

from limo_driver.causal_differentiation import RATE_TOLERANCE

_STATES: Final = 101  # from which the rate is found
_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_SHORTEST, _LONGEST = 1e5, 1e9  # [ns] between states, of any arm


class RateFinder:
    """Finds the rate from stamps and numbers; a lost state widens both alike."""

    def __init__(self) -> None:
        self._taken: list[tuple[int, int]] = []

    def take(self, sequence: int, stamp: int) -> float | None:
        """Take a state.

        Args:
            sequence: Its number.
            stamp: When it was measured [ns].

        Returns:
            The rate [Hz] to three digits, once enough states are known.
        """
        if self._taken and not (sequence > self._taken[-1][0] and stamp > self._taken[-1][1]):
            self._taken.clear()
        self._taken.append((sequence, stamp))
        if len(self._taken) < _STATES:
            return None
        taken = np.array(self._taken)
        steps = taken[_APART:] - taken[:-_APART]
        interval = float(np.median(steps[:, 1] / steps[:, 0]))
        self._taken.clear()
        return float(f"{1e9 / interval:.3g}") if _SHORTEST <= interval <= _LONGEST else None


class RateWatch:
    """Finds out when joint states come at another rate than the one that is served.

    Args:
        rate: That is served [Hz].
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._finder = rate, RateFinder()

    def take(self, sequence: int, stamp: int) -> float | None:
        """Take a state, and return the rate of the last hundred [Hz] if it is another one."""
        found = self._finder.take(sequence, stamp)
        if found is None or abs(found / self._rate - 1.0) <= RATE_TOLERANCE:
            return None
        return found
