"""The rate of numbered joint states, some of which may be lost."""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import Final

import numpy as np

from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE

_STATES: Final = 101  # from which the rate is found
_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_FEW: Final = 10  # steps from which a rate is doubted
_GAP: Final = 0.5  # periods more than one, from which a step is a gap
_MANY_GAPS: Final = 3  # in a row
_REMEMBERED: Final = 200  # steps that say how uneven stamps are
_DEVIATIONS: Final = 4.0
_PER_SECOND: Final = 1e9  # [ns]
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

    To be sure takes a hundred states or more. Meanwhile `doubtful` says whether the last few came
    so fast or slowly that velocities from them may be wrong, beyond how uneven stamps usually are.

    Args:
        rate: That is served [Hz].
    """

    def __init__(self, rate: float) -> None:
        self._rate, self._finder = rate, RateFinder()
        self._period = _PER_SECOND / rate  # [ns]
        self._latest: deque[tuple[int, int]] = deque(maxlen=_FEW + 1)
        self._scatter, self._steps = 0.0, 0  # mean square of steps less 1 [periods²], of so many
        self._gaps = 0  # in a row
        self.doubtful = False

    def take(self, sequence: int, stamp: int) -> float | None:
        """Take a state, and return the rate of the last hundred [Hz] if it is another one."""
        self._doubt(sequence, stamp)
        found = self._finder.take(sequence, stamp)
        if found is None or abs(found / self._rate - 1.0) <= RATE_TOLERANCE:
            return None
        return found

    def _doubt(self, sequence: int, stamp: int) -> None:
        latest = self._latest
        number, before = latest[-1] if latest else (sequence, stamp)
        latest.append((sequence, stamp))
        if sequence <= number or stamp <= before:  # the first, or a source that began anew
            latest.clear()
            latest.append((sequence, stamp))
            self._gaps, self.doubtful = 0, False
            return
        step = (stamp - before) / (self._period * (sequence - number)) - 1.0
        if step > _GAP:  # cycles that nobody numbered; only many say that they are longer ones
            latest.clear()
            latest.append((sequence, stamp))
            self._gaps += 1
            self.doubtful = self._gaps >= _MANY_GAPS
            return
        self._gaps = 0
        self._steps = min(self._steps + 1, _REMEMBERED)
        self._scatter += (step * step - self._scatter) / self._steps
        number, before = latest[0]
        mean = (stamp - before) / (self._period * (sequence - number)) - 1.0
        usual = _DEVIATIONS * sqrt(self._scatter) / (len(latest) - 1)  # of two stamps, not of steps
        self.doubtful = len(latest) > _FEW and abs(mean) > RATE_TOLERANCE + usual
