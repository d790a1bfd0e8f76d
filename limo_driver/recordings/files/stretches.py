"""Stretches: of a log of any length, as many rows as fit into memory, spread over all of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable

Piece = TypeVar("Piece")

MOST: Final = 1_000_000  # rows that are kept; identification takes about 1 kB for each
STRETCH_SECONDS: Final = 25.0  # [s] of a stretch, long beside what a filter loses
STRETCH: Final = 25_000  # rows of one, where its rate is not known yet: that of 1 kHz


_MEMORY: Final = 1 << 30  # bytes that rows may take, however wide they are


def most_rows(width: int) -> int:
    """Return how many rows of so many bytes may be kept."""
    return min(MOST, max(_MEMORY // max(width, 1), 1))


class Stretches(Generic[Piece]):
    """Keep evenly spread stretches of rows that come piece by piece, however many they will be.

    All rows are kept until they are too many; then every second stretch goes, and of those that
    come only every second is kept, and so on.

    Args:
        cut: Returns rows `start` to `stop` of a piece.
        most: Rows that may be kept.
        rows: Of a stretch.
        stride: To begin with; where it is known how many rows will come.
    """

    def __init__(
        self,
        cut: Callable[[Piece, int, int], Piece],
        most: int = MOST,
        rows: int = STRETCH,
        stride: int = 1,
    ) -> None:
        self._cut, self._most, self._rows, self._stride = cut, most, rows, stride
        self._kept: dict[int, list[Piece]] = {}  # by number of the stretch
        self.total = 0  # rows that came

    def add(self, piece: Piece, rows: int) -> None:
        """Take what comes next, a piece of so many rows."""
        start = 0
        while start < rows:
            number, begun = divmod(self.total, self._rows)
            stop = min(rows, start + self._rows - begun)
            if number % self._stride == 0:
                self._kept.setdefault(number, []).append(self._cut(piece, start, stop))
            if len(self._kept) * self._rows > self._most:
                self._stride *= 2
                self._kept = {k: v for k, v in self._kept.items() if k % self._stride == 0}
            self.total += stop - start
            start = stop

    @property
    def spread(self) -> int:
        """Rows of which the kept ones are evenly spread stretches; 0 if all are kept."""
        return self.total if self._stride > 1 else 0

    def pieces(self) -> list[Piece]:
        """Return the pieces that are kept, in the order in which they came."""
        return [piece for pieces in self._kept.values() for piece in pieces]

    def note(self) -> str:
        """Say what was kept, where it is not all."""
        if not self.spread:
            return ""
        return (
            f"of {self.total} rows, {len(self._kept)} stretches of {self._rows} were read, evenly "
            "spread; what is said of rows counts these"
        )
