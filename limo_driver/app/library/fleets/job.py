"""What all diagnoses of a fleet share, and one of them: the same wherever it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING, Final

from limo_driver.app.library.executors.job import attempted
from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from estimators.fleet.outcome import FleetOutcome
    from estimators.fleet.row import FleetRow
    from limo_driver.physics import Simulation
    from limo_driver.recordings.recording import Recording

# As `benchmarks/fleet/cost.py` finds them, of seven joints and Parquet.
_BASE: Final = 0.45e9  # [bytes] of a process that diagnoses
_BY_SIZE: Final = 110.0  # [bytes] more for each of a recording's file
_LARGEST: Final = 5e9  # [bytes] more, whatever the length: longer ones are thinned out
_READ: Final = 6.0  # [bytes] more for each, while it is read in full


@dataclass(frozen=True)
class FleetJob:
    """What all diagnoses of a fleet share."""

    simulation: Simulation
    bandwidth: float | None  # [Hz]; what suits a recording, if none

    def do(self, row: FleetRow) -> FleetOutcome | str:
        """Diagnose one recording on one thread.

        Args:
            row: Whose recording is read.

        Returns:
            How it ended; or, if it was the machine or limo itself that failed, why.
        """
        from estimators.fleet.outcome import FleetOutcome

        start = perf_counter()
        return attempted(
            lambda: self._diagnosed(row, start),
            lambda line: FleetOutcome(perf_counter() - start, line),
        )

    def memory_of(self, row: FleetRow) -> float:
        """Return how much memory a diagnosis takes at most [bytes], by its recording's size."""
        return _BASE + min(_BY_SIZE * row.bytes, _LARGEST) + _READ * row.bytes

    def refused(self, row: FleetRow) -> FleetOutcome | None:
        """Return how a recording ended that cannot be read as one of this arm; None, if it can."""
        from estimators.fleet.outcome import FleetOutcome

        start = perf_counter()
        found = attempted(
            lambda: self._read(row), lambda line: FleetOutcome(perf_counter() - start, line)
        )
        return found if isinstance(found, FleetOutcome) else None

    def _diagnosed(self, row: FleetRow, start: float) -> FleetOutcome:
        from estimators.fleet.outcome import outcome_of
        from limo_driver.app.library.diagnosing import diagnose

        found = diagnose(self.simulation, self._read(row), bandwidth=self.bandwidth)
        return outcome_of(found, perf_counter() - start)

    def _read(self, row: FleetRow) -> Recording:
        from limo_driver.app.library.fleets.sources import at_hand
        from limo_driver.app.library.reading import read

        with at_hand(row.recording) as path:
            try:
                recording = read(path, self.simulation.model)
            except LimoError as error:  # the row names the recording, and not where its copy lay
                raise LimoError(str(error).removeprefix(f"{path}: ")) from error
            return replace(recording, source=str(row.recording))
