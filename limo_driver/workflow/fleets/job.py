"""What all diagnoses of a fleet share, and one of them: the same wherever it runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from estimators.fleet.outcome import FleetOutcome
    from estimators.fleet.row import FleetRow
    from limo_driver.physics import Simulation


@dataclass(frozen=True)
class FleetJob:
    """What all diagnoses of a fleet share."""

    simulation: Simulation
    bandwidth: float | None  # [Hz]; what suits a recording, if none


def diagnose_row(job: FleetJob, row: FleetRow) -> FleetOutcome | str:
    """Diagnose one recording of a fleet on one thread.

    Args:
        job: What all share.
        row: Whose recording is read.

    Returns:
        How it ended; or, if it was the machine or limo itself that failed, why. Then another try
        may end otherwise.
    """
    from threadpoolctl import threadpool_limits

    from estimators.fleet.outcome import FleetOutcome, outcome_of
    from limo_driver.workflow.diagnosing import diagnose
    from limo_driver.workflow.fleets.sources import at_hand
    from limo_driver.workflow.reading import read

    start = perf_counter()
    try:
        with threadpool_limits(1), at_hand(row.recording) as path:
            try:
                recording = read(path, job.simulation.model)
                recording = replace(recording, source=str(row.recording))  # not of a copy
                found = diagnose(job.simulation, recording, bandwidth=job.bandwidth)
            except LimoError as error:
                line = " ".join(str(error).split()).removeprefix(f"{path}: ")
                if _is_of_the_machine(error):
                    return line
                return FleetOutcome(perf_counter() - start, line)
            return outcome_of(found, perf_counter() - start)
    except MemoryError:
        return "the machine had too little memory for it: give fewer `workers`"
    except LimoError as error:  # its files could not be written
        return str(error)
    except Exception as error:  # noqa: BLE001  # one recording does not end the others
        return f"{type(error).__name__}: {' '.join(str(error).split())}"


def _is_of_the_machine(error: BaseException | None) -> bool:
    """Say whether an error came from one of the operating system, or from a want of memory.

    Arrow tells damaged files as errors of the operating system, too, but those have no number.
    """
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno):
            return True
        error = error.__cause__ or error.__context__
    return False
