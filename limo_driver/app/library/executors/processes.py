"""A pool of processes on this machine, as many as its cores and memory bear."""

from __future__ import annotations

from contextlib import suppress
from multiprocessing import connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic

from limo_driver.app.library.executors.job import OutcomeT, TaskT
from limo_driver.runtime.processes.worker_process import WorkerProcess, end_with_parent

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from limo_driver.app.library.executors.job import Job

_MEMINFO: Final = Path("/proc/meminfo")
_LIMIT: Final = Path("/sys/fs/cgroup/memory.max")  # of a container
_TAKEN: Final = Path("/sys/fs/cgroup/memory.current")


class ProcessPool(Generic[TaskT, OutcomeT]):
    """Processes that do tasks one after the other, each its own.

    Args:
        job: What all tasks share.
        workers: How many run side by side at most.
    """

    def __init__(self, job: Job[TaskT, OutcomeT], workers: int) -> None:
        self._job, self._workers = job, workers
        self._memory = _available()  # [bytes]
        self._idle: list[WorkerProcess[TaskT]] = []
        self._busy: dict[Connection[Any, Any], WorkerProcess[TaskT]] = {}

    def has_room(self, task: TaskT) -> bool:
        """Say whether a process is free, and memory for what runs and this task."""
        taken = sum(self._job.memory_of(worker.task) for worker in self._busy.values())
        return not self._busy or (
            len(self._busy) < self._workers and taken + self._job.memory_of(task) <= self._memory
        )

    def submit(self, task: TaskT) -> None:
        """Have a process do a task."""
        worker = self._idle.pop() if self._idle else WorkerProcess(_work, self._job)
        worker.start(task)
        self._busy[worker.connection] = worker

    def ended(self) -> list[tuple[TaskT, OutcomeT | str]]:
        """Wait for processes to end a task, or to die."""
        ready = connection.wait(list(self._busy))
        return [self._received(self._busy.pop(item)) for item in ready]  # type: ignore[arg-type]

    def close(self) -> None:
        """Kill the processes."""
        for worker in (*self._idle, *self._busy.values()):
            worker.stop()

    def _received(self, worker: WorkerProcess[TaskT]) -> tuple[TaskT, OutcomeT | str]:
        try:
            outcome = worker.connection.recv()
        except (EOFError, OSError):
            return worker.task, f"its process ended with status {worker.stop()}"
        self._idle.append(worker)
        return worker.task, outcome


def _work(main: Connection[Any, Any], job: Job[Any, Any]) -> None:
    """Do what comes through the pipe until its other end is closed."""
    end_with_parent()
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            main.send(job.do(main.recv()))


def _available() -> float:
    """Return the memory that this machine or container has left [bytes]; infinite if unknown."""
    found = float("inf")
    with suppress(OSError, ValueError):
        lines = dict(line.split(":") for line in _MEMINFO.read_text().splitlines())
        found = 1024.0 * int(lines["MemAvailable"].split()[0])
    with suppress(OSError, ValueError):  # "max", where there is no limit
        found = min(found, float(_LIMIT.read_text()) - float(_TAKEN.read_text()))
    return found
