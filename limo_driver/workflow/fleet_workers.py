"""Processes that diagnose the recordings of a fleet side by side."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import connection
from time import perf_counter
from typing import TYPE_CHECKING, Any, Final

from limo_driver.errors import ConfigError, LimoError
from limo_driver.worker_process import WorkerProcess, end_with_parent

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from multiprocessing.connection import Connection

    from estimators.fleet.row import FleetRow
    from estimators.fleet.store import FleetStore
    from limo_driver.physics import Simulation

_TRIES: Final = 2  # of a recording whose worker dies


@dataclass(frozen=True)
class FleetJob:
    """What all diagnoses of a fleet share."""

    simulation: Simulation
    store: FleetStore
    bandwidth: float | None  # [Hz]; what suits a recording, if none


def run_fleet(
    job: FleetJob, rows: Iterable[FleetRow], workers: int
) -> Iterator[tuple[FleetRow, str]]:
    """Diagnose recordings in worker processes, and give each as it is finished.

    A worker that dies, for want of memory for example, costs nothing but its present recording,
    which is tried once more. When the caller stops listening, the workers are killed at once.

    Args:
        job: What all share.
        rows: Whose recordings are read, in this order.
        workers: How many run side by side.

    Returns:
        Rows, and an error of those that the store does not have: their worker died, or the machine
        failed them, so that the next call has to try again.

    Raises:
        ConfigError: A worker cannot write.
    """
    waiting = deque((row, 1) for row in rows)
    busy: dict[Connection[Any, Any], WorkerProcess[tuple[FleetRow, int]]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                worker = WorkerProcess[tuple["FleetRow", int]](_work, job)
                worker.start(waiting.popleft())
                busy[worker.connection] = worker
            for ready in connection.wait(list(busy)):
                worker = busy[ready]  # type: ignore[index]  # only connections were waited for
                row, tries = worker.task
                try:
                    halted, failed = worker.connection.recv()
                except (EOFError, OSError):
                    del busy[worker.connection]
                    status = worker.stop()
                    if tries < _TRIES:
                        waiting.appendleft((row, tries + 1))
                    else:
                        yield row, f"its process ended with status {status}, twice"
                    continue
                if halted:
                    raise ConfigError(halted)
                yield row, failed
                if waiting:
                    worker.start(waiting.popleft())
                else:
                    busy.pop(worker.connection).stop()
    finally:
        for worker in busy.values():
            worker.stop()


def _work(main: Connection[Any, Any], job: FleetJob) -> None:
    """Diagnose what comes through the pipe until its other end is closed; tell why, if halted."""
    end_with_parent()
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            row, _ = main.recv()
            try:
                main.send(("", diagnose_row(job, row)))
            except LimoError as error:
                main.send((str(error), ""))


def diagnose_row(job: FleetJob, row: FleetRow) -> str:
    """Diagnose one recording of a fleet, and keep its row, unless it is the machine that failed.

    Args:
        job: What all share.
        row: Whose recording is read.

    Returns:
        Why no row was kept; empty if it was.

    Raises:
        ConfigError: It cannot be written.
    """
    from limo_driver.workflow.diagnosing import diagnose
    from limo_driver.workflow.reading import read

    start = perf_counter()
    try:
        recording = read(row.recording, job.simulation.model)
        found = diagnose(job.simulation, recording, bandwidth=job.bandwidth)
    except LimoError as error:
        line = " ".join(str(error).split()).removeprefix(f"{row.recording}: ")
        if _is_of_the_machine(error):
            return line
        job.store.keep(row.key, perf_counter() - start, line)
        return ""
    except MemoryError:
        return "the machine had too little memory for it: give fewer --workers"
    found.save(job.store.place(row.key))
    job.store.keep(row.key, perf_counter() - start)
    return ""


def _is_of_the_machine(error: BaseException | None) -> bool:
    """Say whether an error came from one of the operating system, or from a want of memory.

    Arrow tells damaged files as errors of the operating system, too, but those have no number.
    """
    while error is not None:
        if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno):
            return True
        error = error.__cause__ or error.__context__
    return False
