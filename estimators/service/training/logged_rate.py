"""At which rate joint states were logged, state by state, and where a clock ran twice."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from limo_driver.network.messages import JOINT_STATE
from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from limo_driver.logs.mcap_file import LoggedMessage

_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_AROUND: Final = 101  # states that say together what the rate is
_BLURRED: Final = 76  # states next to another rate, whose own is not clear
_SILENCE: Final = 1_000_000_000  # [ns], after which states are another stretch
_PER_SECOND: Final = 1e9  # [ns]
_NUMBERS: Final = 2**32  # after which a log's numbers begin anew


@dataclass
class LoggedRates:
    """Stamps and numbers of one topic's joint states, in the order in which they were logged."""

    topic: str
    _stamps: array[int] = field(default_factory=lambda: array("q"))
    _numbers: array[int] = field(default_factory=lambda: array("q"))

    def take(self, message: LoggedMessage) -> None:
        """Look at a message of the log."""
        if message.schema == JOINT_STATE and message.topic == self.topic:
            self._stamps.append(message.publish_time_ns)
            self._numbers.append(message.sequence)

    def newest(self, stamps: NDArray[np.int64]) -> float:
        """Return the rate of the last states that have one [Hz]; NaN if none has.

        Args:
            stamps: Of the states that count [ns].
        """
        logged, interval = self._intervals
        known = np.flatnonzero(np.isin(logged, stamps) & np.isfinite(interval))
        return float(_PER_SECOND / interval[known[-1]]) if known.size else np.nan

    def of_rate(self, stamps: NDArray[np.int64], rate: float) -> NDArray[np.bool_]:
        """Return which stamps (T,) [ns] are of states that came at a rate [Hz], beyond doubt."""
        from scipy.ndimage import minimum_filter1d  # slow to import; a service begins without

        logged, interval = self._intervals
        near = np.abs(interval * rate / _PER_SECOND - 1.0) <= RATE_TOLERANCE  # NaN is not
        for first, stop in pairwise(self._bounds):
            near[first:stop] = minimum_filter1d(near[first:stop], 2 * _BLURRED + 1, mode="nearest")
        return np.isin(stamps, logged[near])

    def twice(self, stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which stamps (T,) [ns] lie where the clock ran twice, since it was set back."""
        logged, found = np.array(self._stamps, dtype=np.int64), np.zeros(stamps.shape, dtype=bool)
        back = np.flatnonzero(np.diff(logged) < 0) + 1
        runs = [(int(part[0]), int(part[-1])) for part in np.split(logged, back) if part.size]
        reached = -1  # by the runs that began earlier
        for first, last in sorted(runs):
            found |= (stamps >= first) & (stamps <= min(last, reached))
            reached = max(reached, last)
        return found

    @property
    def _bounds(self) -> list[int]:
        """Starts of the segments in which numbers and stamps are contiguous, and the last end."""
        stamps = np.diff(np.array(self._stamps, dtype=np.int64))
        numbers = np.diff(np.array(self._numbers, dtype=np.int64)) % _NUMBERS
        goes_on = (stamps > 0) & (stamps < _SILENCE) & (numbers > 0) & (numbers < _SILENCE)
        ends = np.flatnonzero(~goes_on) + 1
        return [0, *ends.tolist(), len(self._stamps)] if self._stamps else [0]

    @property
    def _intervals(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return stamps [ns] and the time from one state to the next around each [ns]."""
        from scipy.ndimage import median_filter  # as above

        stamps = np.array(self._stamps, dtype=np.int64)
        numbers = np.array(self._numbers, dtype=np.int64)
        interval = np.full(stamps.shape, np.nan)
        for first, stop in pairwise(self._bounds):
            apart = min(_APART, stop - first - 1)
            if apart < 1:
                continue
            time, count = (
                v[first + apart : stop] - v[first : stop - apart] for v in (stamps, numbers)
            )
            steps = time / np.maximum(count % _NUMBERS, 1)
            steps = median_filter(steps, min(_AROUND, 2 * (steps.size // 2) + 1), mode="nearest")
            before = apart // 2
            interval[first:stop] = np.pad(steps, (before, apart - before), mode="edge")
        return stamps, interval
