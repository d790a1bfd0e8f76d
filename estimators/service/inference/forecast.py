"""Forecast of when the next joint state comes, from when the latest ones did.

The stamps of a robot are even, and what comes between a stamp and its arrival is nearly the same
for each state, but for what the network and other programs add now and then. So the next one is
due a period after the stamp of the last, and as long after that as the quicker ones took.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

_STATES: Final = 24  # from which it is told
_FEW: Final = 2  # of them, the quickest and the slowest, that say nothing
_SHARE: Final = 0.1  # of a period, that may be spent awake
_LEAST: Final = 3e-4  # [s] awake for each state, on any machine
_TIMES: Final = 16  # from which it is told how long it takes to wake and to rehearse
_FORGOTTEN: Final = 100  # states without a rehearsal, after which it is tried how long one takes
_NANOSECONDS: Final = 1e-9


@dataclass(frozen=True)
class Due:
    """When a state is due; times are of this machine's clock [s]."""

    begin: float  # when to wake, so that all is rehearsed when the state may come
    end: float  # after which it will hardly come any more, or was lost
    period: float  # of the states


class Forecast:
    """When the next state is due, if that is known well enough to await it at little cost."""

    def __init__(self) -> None:
        self.due: Due | None = None
        self._first = 0  # [ns], stamp that others are counted from
        self._stamps: deque[float] = deque(maxlen=_STATES)  # [s] after the first
        self._delays: deque[float] = deque(maxlen=_STATES)  # [s] of this machine's clock, after it
        self._waking: deque[float] = deque(maxlen=_TIMES)  # [s] after it was to
        self._rehearsing: deque[float] = deque(maxlen=_TIMES)  # [s]
        self._idle = 0  # states since the last rehearsal

    def came(self, stamp: int, arrived: float) -> None:
        """Take a state, and foresee the next one.

        Args:
            stamp: When it was measured, of its source [ns].
            arrived: When it came, of this machine's clock [s].
        """
        time = _NANOSECONDS * (stamp - self._first)
        if self._stamps and time == self._stamps[-1]:  # again, with nothing new in it
            return
        if not self._stamps or time <= self._stamps[-1]:
            self._stamps.clear()
            self._delays.clear()
            self._first, time = stamp, 0.0
        self._stamps.append(time)
        self._delays.append(arrived - time)
        self._idle += 1
        if self._idle > _FORGOTTEN and self._rehearsing:
            self._idle = 0
            self._rehearsing.popleft()
        self.due = self._next()

    def woke(self, late: float) -> None:
        """Note how long after `begin` who awaits a state was awake [s]."""
        self._waking.append(late)

    def rehearsed(self, took: float) -> None:
        """Note how long a rehearsal took [s]."""
        self._idle = 0
        self._rehearsing.append(took)

    def _next(self) -> Due | None:
        lasted = self._stamps[-1] - self._stamps[0]
        if len(self._stamps) < _STATES or _SHARE * lasted < _LEAST * _STATES:
            return None
        period = median(after - before for before, after in pairwise(self._stamps))
        delays = sorted(self._delays)
        early, middle, late = delays[_FEW], delays[_STATES // 2], delays[-1 - _FEW]
        took, most = _usual(self._rehearsing), _SHARE * period
        if took + middle - early > most:
            return None
        first = self._stamps[-1] + period + early
        return Due(
            first - took - _usual(self._waking), first + min(late - early, most - took), period
        )


def _usual(times: Sequence[float]) -> float:
    """Return a time [s] that most others are shorter than."""
    return sorted(times)[3 * len(times) // 4] if times else 0.0
