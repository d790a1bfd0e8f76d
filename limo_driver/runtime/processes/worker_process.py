"""Processes that do tasks side by side: each takes one after the other through a pipe."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import TYPE_CHECKING, Any, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable
    from multiprocessing.connection import Connection
    from multiprocessing.context import SpawnProcess

TaskT = TypeVar("TaskT")
JobT = TypeVar("JobT")


class WorkerProcess(Generic[TaskT]):
    """One process and the task that it does.

    Args:
        work: Runs in the process, with its end of the pipe. It takes tasks until the pipe is
            closed, calls `end_with_parent` first, and answers each as it likes.
        job: What all tasks share, the second argument of `work`.
    """

    task: TaskT

    def __init__(self, work: Callable[[Connection[Any, Any], JobT], None], job: JobT) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(target=work, args=(theirs, job), daemon=True)
        self.process.start()
        theirs.close()  # so that the end of the process is the end of the pipe

    def start(self, task: TaskT) -> None:
        """Send the next task."""
        self.task = task
        with suppress(BrokenPipeError):  # it has died, which the next receipt tells
            self.connection.send(task)

    def stop(self) -> int | None:
        """End the process, whatever it does, and return its exit status."""
        self.process.kill()
        self.process.join()
        self.connection.close()
        return self.process.exitcode


def end_with_parent() -> None:
    """Have this worker process end when its parent is gone, even in the midst of its work.

    Ctrl-C is left to the parent, which ends its workers.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
