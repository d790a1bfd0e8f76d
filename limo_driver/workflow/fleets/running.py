"""Run the diagnoses of a fleet wherever there is room, and try again what a machine failed."""

from __future__ import annotations

from collections import Counter, deque
from contextlib import closing
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from estimators.fleet.outcome import FleetOutcome
    from estimators.fleet.row import FleetRow

_TRIES: Final = 2  # of a recording that a machine fails
# As `benchmarks/fleet/cost.py` finds them, of seven joints and Parquet.
_BASE: Final = 0.45e9  # [bytes] of a process that diagnoses
_BY_SIZE: Final = 110.0  # [bytes] more for each of a recording's file
_LARGEST: Final = 5e9  # [bytes] more, whatever the length: longer ones are thinned out
_READ: Final = 6.0  # [bytes] more for each, while it is read in full


class FleetExecutor(Protocol):
    """Where diagnoses run: it takes rows while it has room, and gives each back as it ends."""

    def has_room(self, row: FleetRow) -> bool:
        """Say whether this row can be submitted now; always, where nothing runs."""
        ...

    def submit(self, row: FleetRow) -> None:
        """Begin the diagnosis of a row."""
        ...

    def ended(self) -> Sequence[tuple[FleetRow, FleetOutcome | str]]:
        """Wait for rows to end, at least one; text says why a machine failed it."""
        ...

    def close(self) -> None:
        """End whatever still runs."""
        ...


def run_fleet(
    executor: FleetExecutor, rows: Iterable[FleetRow]
) -> Iterator[tuple[FleetRow, FleetOutcome | str]]:
    """Diagnose recordings side by side, and give each as it ends.

    A worker that dies, for want of memory for example, or the node that it is on, costs nothing
    but its present recording, which is tried once more. When the caller stops listening, all ends.

    Args:
        executor: Where they run; closed in the end.
        rows: Whose recordings are read, in this order.

    Returns:
        Each row with how it ended, or why it did not, twice: then another call has to try again.
    """
    waiting = deque(rows)
    tries: Counter[str] = Counter()
    running = 0
    with closing(executor):
        while waiting or running:
            while waiting and executor.has_room(waiting[0]):
                executor.submit(waiting.popleft())
                running += 1
            for row, outcome in executor.ended():
                running -= 1
                tries[row.key] += 1
                if isinstance(outcome, str) and tries[row.key] < _TRIES:
                    waiting.append(row)
                else:
                    yield row, outcome


def memory_of(row: FleetRow) -> float:
    """Return how much memory a diagnosis takes at most [bytes], by the size of its recording."""
    return _BASE + min(_BY_SIZE * row.bytes, _LARGEST) + _READ * row.bytes
