"""The budget of a reader: what a file may unpack to, how many rows, how long it may take."""

from __future__ import annotations

from dataclasses import dataclass
from time import thread_time
from typing import TYPE_CHECKING, Final, NoReturn, TypeVar

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from limo_driver.errors import PlacedError, RecordingError

_Piece = TypeVar("_Piece")
_MIB: Final = 1 << 20


@dataclass(frozen=True)
class ReadingBudget:
    """What reading a file may take.

    Time is that of the CPU, which no busy machine makes longer. Ordinary logs take a tenth of it,
    and are packed ten times at most; what is one value alone is packed a thousand times.
    """

    memory: int = 1 << 28  # bytes that any file may unpack to
    ratio: int = 100  # times its size that a larger one may
    rows: int = 10_000_000  # of any file
    rows_per_byte: int = 100  # more; a time that goes on evenly can be told in few bits
    seconds: float = 4.0  # of any file [s]
    seconds_per_byte: float = 2e-6  # more [s]

    def memory_for(self, size: int) -> int:
        """Return what a file of a size may unpack to [bytes]."""
        return max(self.memory, self.ratio * size)

    def rows_for(self, size: int) -> int:
        """Return how many rows a file of a size may have."""
        return self.rows + self.rows_per_byte * size

    def seconds_for(self, size: int) -> float:
        """Return how long a file of a size may be read [s]."""
        return self.seconds + self.seconds_per_byte * size


class Spent:
    """What reading a file has taken so far, and the refusal of what goes beyond its budget.

    Its clock runs from the beginning, and stands while what was read is used (`metered`).

    Args:
        path: The file.
        error: Raised for it.
        budget: That it has.
    """

    def __init__(
        self,
        path: Path,
        error: type[PlacedError | RecordingError],
        budget: ReadingBudget | None = None,
    ) -> None:
        self.path, self._error, self.budget = path, error, budget or ReadingBudget()
        self._size = path.stat().st_size
        self._rows = self._unpacked = 0
        self._before, self._began = 0.0, thread_time()

    def take(self, *, rows: int = 0, unpacked: int = 0) -> None:
        """Count rows and bytes, and refuse what is too much.

        Raises:
            error: More rows or bytes than its budget has.
        """
        self._rows += rows
        self._unpacked += unpacked
        if self._rows > (most := self.budget.rows_for(self._size)):
            self._refuse(f"has {self._rows} rows or more", f"{most}")
        if self._unpacked > (most := self.budget.memory_for(self._size)):
            given = f"unpacks to {self._unpacked / _MIB:.0f} MiB or more"
            self._refuse(given, f"{most / _MIB:.0f} MiB")

    def check_time(self) -> None:
        """Refuse what takes too long.

        Raises:
            error: It does.
        """
        if self.is_over:
            most = f"{self.budget.seconds_for(self._size):.3g} s"
            self._refuse(f"takes more than {most} of CPU time to read", most)

    @property
    def is_over(self) -> bool:
        """Whether it has taken too long."""
        return self.seconds > self.budget.seconds_for(self._size)

    @property
    def seconds(self) -> float:
        """CPU time that reading has taken [s]."""
        return self._before + thread_time() - self._began

    def metered(self, pieces: Iterator[_Piece], rows: int = 1) -> Iterator[_Piece]:
        """Yield pieces and count their rows, and the time that they take, not that of their use.

        Args:
            pieces: What is read, one after the other.
            rows: Of each.

        Raises:
            error: More rows or seconds than its budget has.
        """
        for piece in pieces:
            self.take(rows=rows)
            self.check_time()
            self._before = self.seconds
            yield piece
            self._began = thread_time()

    def _refuse(self, given: str, most: str) -> NoReturn:
        raise self._error(
            f"{given}, expected at most {most} of a file of {self._size} bytes", path=self.path
        )
