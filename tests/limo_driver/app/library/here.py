"""An executor that does each task where it is, so that a test needs no process."""

from __future__ import annotations

from typing import Any


class Here:
    """Does a task when its end is waited for, and counts.

    Args:
        job: What all tasks share.
    """

    done = 0  # by all of them

    def __init__(self, job: Any, *_: object) -> None:
        self.job, self.tasks = job, []

    def has_room(self, _task: Any) -> bool:
        """Say whether nothing waits."""
        return not self.tasks

    def submit(self, task: Any) -> None:
        """Take a task."""
        self.tasks.append(task)

    def ended(self) -> list[tuple[Any, Any]]:
        """Do it."""
        task = self.tasks.pop()
        Here.done += 1
        return [(task, self.job.do(task))]

    def close(self) -> None:
        """Do nothing."""
