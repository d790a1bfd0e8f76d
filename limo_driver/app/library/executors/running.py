"""Run tasks wherever there is room, and try again what a machine failed."""

from __future__ import annotations

import os
from collections import Counter, deque
from contextlib import closing
from typing import TYPE_CHECKING, Any, Final, Protocol

from limo_driver.app.library.executors.job import OutcomeT, OutcomeT_co, TaskT
from limo_driver.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from limo_driver.app.library.executors.job import Job

_TRIES: Final = 2  # of a task that a machine fails


class Executor(Protocol[TaskT, OutcomeT_co]):
    """Where tasks run: it takes them while it has room, and gives each back as it ends."""

    def has_room(self, task: TaskT) -> bool:
        """Say whether this task can be submitted now; always, where nothing runs."""
        ...

    def submit(self, task: TaskT) -> None:
        """Begin a task."""
        ...

    def ended(self) -> Sequence[tuple[TaskT, OutcomeT_co | str]]:
        """Wait for tasks to end, at least one; text says why a machine failed it."""
        ...

    def close(self) -> None:
        """End whatever still runs."""
        ...


def check_place(workers: int | None, on: str) -> None:
    """Check what says where tasks run.

    Args:
        workers: How many run side by side at most; one for each core, if none.
        on: "processes" or "ray".

    Raises:
        ConfigError: There are no workers, or there is no such place.
    """
    if workers is not None and workers < 1:
        raise ConfigError(f"workers is {workers}, expected at least 1")
    if on not in {"processes", "ray"}:
        raise ConfigError(f"on is {on}, expected processes or ray")


def executor_of(job: Job[TaskT, OutcomeT], workers: int | None, on: str) -> Executor[Any, Any]:
    """Return where the tasks of a job run; what says so is checked before.

    Raises:
        ConfigError: The cluster cannot be used.
    """
    if on == "ray":
        from limo_driver.app.library.executors.ray_cluster import RayCluster

        return RayCluster(job, workers)
    from limo_driver.app.library.executors.processes import ProcessPool

    return ProcessPool(job, workers or len(os.sched_getaffinity(0)))


def run_all(
    executor: Executor[TaskT, OutcomeT], tasks: Iterable[TaskT]
) -> Iterator[tuple[TaskT, OutcomeT | str]]:
    """Do tasks side by side, and give each as it ends.

    A worker that dies, for want of memory for example, or the node that it is on, costs nothing
    but its present task, which is tried once more. When the caller stops listening, all ends.

    Args:
        executor: Where they run; closed in the end.
        tasks: In this order.

    Returns:
        Each task with how it ended, or why it did not, twice: then another call has to try again.
    """
    waiting = deque(tasks)
    tries: Counter[int] = Counter()  # by task, which stays where it is
    running = 0
    with closing(executor):
        while waiting or running:
            while waiting and executor.has_room(waiting[0]):
                executor.submit(waiting.popleft())
                running += 1
            for task, outcome in executor.ended():
                running -= 1
                tries[id(task)] += 1
                if isinstance(outcome, str) and tries[id(task)] < _TRIES:
                    waiting.append(task)
                else:
                    yield task, outcome
