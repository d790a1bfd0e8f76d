"""The last states of an arm, and how fast they come."""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from limo_driver.recordings.filters.causal_differentiation import RATE_TOLERANCE

if TYPE_CHECKING:
    from limo_driver.types import FloatArray

_STATES: Final = 101  # from which the rate is found
_APART: Final = 25  # states whose stamps are compared, so that uneven ones count for less
_FEW: Final = 10  # steps from which a rate is doubted
_GAP: Final = 0.5  # periods more than one, from which a step is a gap
_MANY_GAPS: Final = 3  # in a row
_REMEMBERED: Final = 200  # steps that say how uneven stamps are
_DEVIATIONS: Final = 4.0
_PER_SECOND: Final = 1e9  # [ns]
_SHORTEST, _LONGEST = 1e5, 1e9  # [ns] between states, of any arm


class StateRows(NamedTuple):
    """T states that follow each other."""

    time: FloatArray  # (T,) [s]
    position: FloatArray  # (T, n) [rad]
    torque: FloatArray | None  # (T, n) [N m], measured; None where it is not

    def part(self, first: int, stop: int) -> StateRows:
        """Return some of them."""
        rows = slice(first, stop)
        torque = None if self.torque is None else self.torque[rows]
        return StateRows(self.time[rows], self.position[rows], torque)


_SPARE: Final = 4096  # rows that may be overwritten while others are copied


class History:
    """A ring of the latest states of n joints; one thread appends, others copy.

    Args:
        n: Number of joints.
        capacity: States kept.
    """

    def __init__(self, n: int, capacity: int) -> None:
        self.capacity = capacity
        # Written at once: memory that is only promised would grow for as long as the ring fills.
        self._time = np.full(capacity + _SPARE, np.nan)
        self._values = np.full((capacity + _SPARE, 2, n), np.nan)
        self.count = 0  # ever appended
        self.began = 0  # count at which the present memory began
        self._measured = False  # torque came with all states of the present memory

    def append(self, time: float, position: FloatArray, torque: FloatArray | None) -> None:
        """Keep a state; the oldest goes when there is no room.

        Torque comes with all states of a memory, or with none.
        """
        row = self.count % self._time.size
        self._time[row] = time
        self._values[row, 0] = position
        self._measured = torque is not None
        if torque is not None:
            self._values[row, 1] = torque
        self.count += 1

    def restart(self) -> None:
        """Note that memory is reset before the next state."""
        self.began = self.count

    @property
    def first(self) -> int:
        """Number of the oldest state of the present memory that is still here."""
        return max(self.began, self.count - self.capacity)

    def since(self, first: int, most: int | None = None) -> StateRows:
        """Copy the states from number `first` on, or the first `most` of them.

        Raises:
            IndexError: They are no longer all here.
        """
        if first < self.count - self._time.size:
            raise IndexError(f"state {first} is no longer kept")
        stop = self.count if most is None else min(self.count, first + most)
        rows = np.arange(first, stop) % self._time.size
        torque = self._values[rows, 1] if self._measured else None
        return StateRows(self._time[rows], self._values[rows, 0], torque)


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
