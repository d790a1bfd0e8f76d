"""What an executor does: a job that many tasks share, and how the end of a task is told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeVar

from limo_driver.errors import LimoError

if TYPE_CHECKING:
    from collections.abc import Callable

TaskT = TypeVar("TaskT")
OutcomeT = TypeVar("OutcomeT")
TaskT_contra = TypeVar("TaskT_contra", contravariant=True)
OutcomeT_co = TypeVar("OutcomeT_co", covariant=True)


class Job(Protocol[TaskT_contra, OutcomeT_co]):
    """What many tasks share, sent once to each process that does them."""

    def do(self, task: TaskT_contra, /) -> OutcomeT_co | str:
        """Do one task on one thread.

        Returns:
            How it ended; or, if it was the machine or limo itself that failed, why. Then another
            try may end otherwise.
        """
        ...

    def memory_of(self, task: TaskT_contra, /) -> float:
        """Return how much memory a task takes at most [bytes]."""
        ...


def attempted(work: Callable[[], OutcomeT], refused: Callable[[str], OutcomeT]) -> OutcomeT | str:
    """Do a task on one thread, and tell what was given wrongly from what the machine failed.

    Args:
        work: Does it.
        refused: Makes an outcome of the line that says why what was given cannot be used.

    Returns:
        The outcome, or the line that says what the machine failed in.
    """
    from threadpoolctl import threadpool_limits

    try:
        with threadpool_limits(1):
            return work()
    except MemoryError:
        return "the machine had too little memory for it: give fewer `workers`"
    except LimoError as error:
        line = " ".join(str(error).split())
        return line if _is_of_the_machine(error) else refused(line)
    except Exception as error:  # noqa: BLE001  # one task does not end the others
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
