"""The latest joint states, from which the memory of another model can be made."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from limo_driver.types import FloatArray


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
